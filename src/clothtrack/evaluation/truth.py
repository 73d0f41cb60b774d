"""True states of the cloth, if known; only evaluation reads them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from clothtrack._shown import short_repr
from clothtrack.errors import InvalidResultError
from clothtrack.geometry.closest_point import closest_on_mesh, interpolate


@dataclass(frozen=True, eq=False)
class Truth:
    """The true mesh at some frames of a recording.

    Attributes:
        positions: true vertices in the world [m], per frame.
        faces: vertex indices per triangle.
        frames: frame numbers in the recording.
        canonical: canonical coordinates of the true vertices [m]; None if only the surface was
            measured, so that no vertex error can be computed.
    """

    positions: Float[np.ndarray, "frames vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    frames: Int[np.ndarray, " frames"]
    canonical: Float[np.ndarray, "vertices 3"] | None = None

    __repr__ = short_repr

    @classmethod
    def load(cls, path: Path | str) -> "Truth":
        """Read `positions`, `faces`, `frames` and the optional `canonical` from an NPZ file.

        Raises:
            InvalidResultError: an array is missing or misshapen; the error names file and array.
        """
        path = Path(path)
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
        except Exception as error:
            # NumPy, zipfile and zlib raise a dozen kinds of exception for a damaged file.
            raise InvalidResultError(
                f"{path}: cannot be read as a truth file ({error}); give the NPZ file that "
                "`clothtrack simulate` wrote beside the recordings"
            ) from error
        _check(arrays, path)
        canonical = arrays.get("canonical")
        return cls(
            arrays["positions"].astype(np.float64),
            arrays["faces"].astype(np.int64),
            arrays["frames"].astype(np.int64),
            None if canonical is None else canonical.astype(np.float64),
        )

    def at(self, frame: int) -> Float[np.ndarray, "vertices 3"] | None:
        """Return the true vertices [m] at a frame of the recording; None if it is unknown."""
        places = np.flatnonzero(self.frames == frame)
        return None if len(places) == 0 else self.positions[places[0]]


def material_map(
    truth_canonical: Float[np.ndarray, "true_vertices 3"],
    truth_faces: Int[np.ndarray, "true_faces 3"],
    canonical: Float[np.ndarray, "vertices 3"],
) -> tuple[Int[np.ndarray, " vertices"], Float[np.ndarray, "vertices 3"]]:
    """Return the place of each vertex of a mesh on the true mesh of the same garment.

    Canonical coordinates identify material points for any triangulation. Therefore the closest
    point on the true mesh in canonical space is the same material point.
    """
    return closest_on_mesh(canonical, truth_canonical, truth_faces)


def material_points(
    positions: Float[np.ndarray, "true_vertices 3"],
    faces: Int[np.ndarray, "true_faces 3"],
    where: tuple[Int[np.ndarray, " vertices"], Float[np.ndarray, "vertices 3"]],
) -> Float[np.ndarray, "vertices 3"]:
    """Return the world positions [m] of the material points that `material_map` found."""
    face, weights = where
    return interpolate(weights, positions[faces[face]])


def _check(arrays: Mapping[str, np.ndarray], path: Path) -> None:
    missing = [name for name in ("positions", "faces", "frames") if name not in arrays]
    if missing:
        raise InvalidResultError(
            f"{path}: has no array {missing[0]!r} (found {', '.join(sorted(arrays)) or 'none'})"
        )
    positions, faces, frames = (arrays[name] for name in ("positions", "faces", "frames"))
    if frames.ndim != 1 or positions.ndim != 3 or positions.shape[::2] != (len(frames), 3):
        raise InvalidResultError(
            f"{path}: positions has shape {positions.shape} and frames {frames.shape}; expected "
            "(frames, vertices, 3) and (frames,)"
        )
    count = positions.shape[1]
    if faces.ndim != 2 or len(faces) == 0 or faces.min() < 0 or faces.max() >= count:
        raise InvalidResultError(
            f"{path}: faces must name vertices 0 to {count - 1}; write the mesh again"
        )
    if "canonical" in arrays and arrays["canonical"].shape != (count, 3):
        raise InvalidResultError(
            f"{path}: canonical has shape {arrays['canonical'].shape}, expected ({count}, 3)"
        )
    if not np.isfinite(positions).all():
        raise InvalidResultError(f"{path}: positions are not finite; simulate it again")
