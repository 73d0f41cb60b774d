"""A depth picture to reconstruct: from a recording, or one file and what is known of its camera."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera, about_vertical
from clothtrack.reconstruction.data.pseudo_labels import cloth_picture
from clothtrack.recordings.pictures import read_depth, read_mask
from clothtrack.recordings.point_cloud import cloth_measured
from clothtrack.recordings.recording import Table
from clothtrack.recordings.segmentation import HeightSegmenter
from clothtrack.recordings.store import read_recording

USUAL_FOCAL = 0.94
"""Focal length per width of the picture of a usual depth camera: 56 degrees across."""

_DISTANCE_STEP_M = 0.004


@dataclass(frozen=True, eq=False)
class DepthInput:
    """What the network is asked about.

    Attributes:
        depth_m: measured depth [m]; 0 where nothing was measured.
        mask: where cloth was measured.
        camera: that took it; world z up.
        table: what the cloth lies on.
        kind: the garment, when it is known.
    """

    depth_m: Float[np.ndarray, "height width"]
    mask: Bool[np.ndarray, "height width"]
    camera: Camera
    table: Table | None
    kind: str | None = None

    def scaled(self, factor: float) -> "DepthInput":
        """The same picture of a world that is larger by a factor."""
        table = self.table
        if table is not None:
            table = replace(table, point=np.asarray(table.point) * factor)
        return replace(
            self, depth_m=self.depth_m * factor, camera=self.camera.scaled(factor), table=table
        )

    def turned(self, angle_rad: float) -> "DepthInput":
        """The same picture of a world that is turned about the vertical through its origin."""
        turn, table = about_vertical(angle_rad), self.table
        if table is not None:
            table = replace(table, point=turn @ table.point, normal=turn @ table.normal)
        return replace(self, camera=self.camera.turned(angle_rad), table=table)


def from_recording(folder: Path, frame: int) -> DepthInput:
    """A frame of a recording.

    Raises:
        InvalidRecordingError: it cannot be read, or has no such frame or no depth.
    """
    recording = read_recording(folder)
    if not 0 <= frame < len(recording.frames):
        raise InvalidRecordingError(
            f"{folder}: there is no frame {frame}; it has 0 to {len(recording.frames) - 1}"
        )
    depth, mask, camera = cloth_picture(recording, recording.frames[frame])
    return DepthInput(depth, mask, camera, recording.table, recording.cloth.kind)


def from_picture(
    path: Path,
    *,
    mask: Path | None = None,
    depth_unit_m: float = 0.001,
    focal: float | None = None,
    table_distance_m: float | None = None,
) -> DepthInput:
    """A 16-bit depth picture of a camera that looks straight down on a table.

    Args:
        path: PNG file.
        mask: picture of where the cloth is; what stands out of the table when None.
        depth_unit_m: metres per unit of the file.
        focal: focal length [pixels]; that of a usual camera when None.
        table_distance_m: from the camera to the table [m]; the most frequent depth when None.

    Raises:
        InvalidRecordingError: a file cannot be read, sizes differ, or nothing was measured.
        InvalidConfigError: a number that must be positive is not.
    """
    _require_positive(depth_unit=depth_unit_m)
    depth = read_depth(path, depth_unit_m)
    return from_depth(depth, str(path), mask=mask, focal=focal, table_distance_m=table_distance_m)


def from_depth(
    depth: Float[np.ndarray, "height width"],
    name: str,
    *,
    mask: Path | None = None,
    focal: float | None = None,
    table_distance_m: float | None = None,
) -> DepthInput:
    """Measured depth [m] of a camera that looks straight down on a table.

    Args:
        depth: 0 where nothing was measured.
        name: what messages call it.
        mask: as for `from_picture`, and so are the others.
        focal: focal length [pixels].
        table_distance_m: from the camera to the table [m].

    Raises:
        InvalidRecordingError: the mask cannot be read, sizes differ, or nothing was measured.
        InvalidConfigError: a number that must be positive is not.
    """
    _require_positive(focal=focal, table_distance=table_distance_m)
    height, width = depth.shape
    focal = focal or USUAL_FOCAL * width
    distance = table_distance_m or _usual_depth(depth, name)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = distance
    camera = Camera("top", width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, pose)
    table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    found = HeightSegmenter()(None, depth, camera, table) if mask is None else read_mask(mask)
    if found.shape != depth.shape:
        raise InvalidRecordingError(
            f"{mask} has {found.shape[1]} x {found.shape[0]} pixels, {name} has {width} x "
            f"{height}; give a mask of the same picture"
        )
    return DepthInput(depth, cloth_measured(depth, found, camera), camera, table)


def _require_positive(**given: float | None) -> None:
    for name, value in given.items():
        if value is not None and not 0.0 < value < float("inf"):
            raise InvalidConfigError(f"{name} is {value}; it must be positive and finite")


def _usual_depth(depth: Float[np.ndarray, "height width"], name: str) -> float:
    """The most frequent depth [m]: the table's, in a picture of a cloth on a table."""
    measured = depth[depth > 0]
    if len(measured) == 0:
        raise InvalidRecordingError(
            f"{name}: no pixel has a depth; check that the camera measured, and the file's unit"
        )
    steps = np.bincount((measured / _DISTANCE_STEP_M).astype(np.int64))
    step = int(steps.argmax())
    near = measured[np.abs(measured / _DISTANCE_STEP_M - step - 0.5) < 1.0]
    return float(np.median(near))
