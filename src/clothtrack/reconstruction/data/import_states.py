"""States of other data sets: CLOTH3D-style folders of meshes, GarmentNets-style Zarr groups.

Both keep garments as they hang or are worn, z up. Their rest pose becomes the rest shape and the
canonical pose: its lateral axis is our x, its height our y, its front our z, so that a garment
faces the same way as those of `simulation/garments.py`. States are moved so that they stand on the
table, around the origin; their recipe is "imported".
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from jaxtyping import Float, Float32, Int

from clothtrack.errors import InvalidMeshError, InvalidResultError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.state_store import StateShard

REST_FILE = "rest.obj"


def import_mesh_folder(
    folder: Path, kind: str, *, rest: str = REST_FILE, y_up: bool = False
) -> StateShard:
    """A garment as Wavefront files: one rest mesh, and one mesh of the same faces per state.

    Args:
        folder: holds the files, one level deep; states are taken in the order of their names.
        kind: what to call the garment.
        rest: name of the rest mesh.
        y_up: the files have y up, not z.

    Raises:
        InvalidMeshError: naming the file and what is wrong with it, or what is missing.
    """
    folder = Path(folder)
    rest_path = folder / rest
    if not rest_path.is_file():
        raise InvalidMeshError(
            f"{rest_path}: there is no rest mesh; name the one of this garment with rest="
        )
    files = sorted(path for path in folder.glob("*.obj") if path.name != rest)
    if not files:
        raise InvalidMeshError(f"{folder}: there is no state beside {rest}; add one .obj per state")
    vertices, faces = _read_obj(rest_path, y_up=y_up)
    states = []
    for path in files:
        posed, posed_faces = _read_obj(path, y_up=y_up)
        if posed.shape != vertices.shape or not np.array_equal(posed_faces, faces):
            raise InvalidMeshError(
                f"{path}: {len(posed)} vertices and {len(posed_faces)} triangles that are not "
                f"those of {rest} ({len(vertices)} and {len(faces)}); states need the faces of "
                "the rest mesh, in its order"
            )
        states.append(_on_table(posed))
    return _shard(kind, vertices, faces, states, str(rest_path))


def import_garmentnets(root: Path, category: str, kind: str) -> Iterator[StateShard]:
    """The samples of a category of a GarmentNets Zarr store, one shard per garment.

    A garment has a sample per vertex that it was gripped at (`ID_GARMENT_GRIP`). Its normalised
    coordinates become metres again by the category's union box and the sample's scale.

    Args:
        root: the store: a folder with a group per category.
        category: such as "Tshirt".
        kind: what to call the garments.

    Yields:
        One shard per garment, in the order of their names.

    Raises:
        InvalidResultError: naming the sample and the array that is missing or does not fit.
    """
    where = Path(root) / category
    try:
        group = zarr.open_group(Path(root), mode="r")[category]
        box = np.asarray(group["summary/cloth_canonical_aabb_union"][...], np.float64)
        names = sorted(group["samples"].group_keys())
    except (OSError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise InvalidResultError(
            f"{where}: not a category of a GarmentNets store ({error}); it needs samples/ and "
            "summary/cloth_canonical_aabb_union"
        ) from error
    centre = box.reshape(2, 3).mean(axis=0)
    garments: dict[str, list[str]] = {}
    for name in names:
        garments.setdefault(name.rpartition("_")[0], []).append(name)
    if not garments:
        raise InvalidResultError(f"{where}: there are no samples in it")
    for samples in garments.values():
        yield _garment_of(group["samples"], samples, centre, kind, where)


def _garment_of(
    group: Any, samples: Sequence[str], centre: np.ndarray, kind: str, where: Path
) -> StateShard:
    """All samples of one garment as a shard; they must have the same faces."""
    first: tuple[np.ndarray, np.ndarray] | None = None
    states = []
    for name in samples:
        told = f"{where}/samples/{name}"
        try:
            sample = group[name]
            scale = float(sample.attrs["scale"])
            posed, unit, faces = (
                np.asarray(sample[f"mesh/{array}"][...])
                for array in ("cloth_verts", "cloth_nocs_verts", "cloth_faces_tri")
            )
        except (OSError, KeyError, ValueError, TypeError, RuntimeError) as error:
            raise InvalidResultError(
                f"{told}: cannot be read ({error}); it needs the attribute scale and mesh/ with "
                "cloth_verts, cloth_nocs_verts and cloth_faces_tri"
            ) from error
        if not (posed.shape == unit.shape == (len(posed), 3)) or faces.shape != (len(faces), 3):
            raise InvalidResultError(
                f"{told}: cloth_verts {posed.shape}, cloth_nocs_verts {unit.shape} and "
                f"cloth_faces_tri {faces.shape} must be (vertices, 3) twice and (faces, 3)"
            )
        if not np.isfinite(scale) or scale <= 0.0:
            raise InvalidResultError(f"{told}: scale is {scale}; it must be above 0")
        canonical = (unit.astype(np.float64) - 0.5) / scale + centre
        if first is None:
            first = canonical, faces
        elif len(first[0]) != len(canonical) or not np.array_equal(first[1], faces):
            raise InvalidResultError(
                f"{told}: its mesh has other faces than {samples[0]}, the same garment; "
                "leave one of them out"
            )
        states.append(_on_table(posed.astype(np.float64)))
    assert first is not None
    try:
        return _shard(kind, first[0], first[1], states, f"{where}/samples/{samples[0]}")
    except InvalidMeshError as error:
        raise InvalidResultError(str(error)) from error


def _shard(
    kind: str,
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    states: Sequence[Float32[np.ndarray, "vertices 3"]],
    where: str,
) -> StateShard:
    """The shard of one garment, each state an episode of its own."""
    rest = _facing_up(vertices)
    try:
        mesh = ClothMesh(rest, faces.astype(np.int32), rest.copy())
        return StateShard(
            kind=kind,
            mesh=mesh,
            positions=np.stack(states),
            episodes=np.arange(len(states), dtype=np.int32),
            recipes=("imported",) * len(states),
            seed=0,
        )
    except (InvalidMeshError, InvalidResultError) as error:
        raise InvalidMeshError(f"{where}: {error}") from error


def _facing_up(vertices: Float[np.ndarray, "vertices 3"]) -> Float[np.ndarray, "vertices 3"]:
    """A garment that stands with z up and its front towards -y, laid on its back, centred [m]."""
    x, y, z = np.asarray(vertices, np.float64).T
    laid = np.column_stack([x, z, -y])
    return laid - 0.5 * (laid.min(axis=0) + laid.max(axis=0))


def _on_table(vertices: Float[np.ndarray, "vertices 3"]) -> Float32[np.ndarray, "vertices 3"]:
    """The same pose with its lowest vertex on the table and its middle over the origin [m]."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]]
    return (vertices - middle).astype(np.float32)


def _read_obj(
    path: Path, *, y_up: bool
) -> tuple[Float[np.ndarray, "vertices 3"], Int[np.ndarray, "faces 3"]]:
    """Vertices [m], z up, and triangles of a Wavefront file; larger faces are cut into a fan.

    Raises:
        InvalidMeshError: with the file and the line.
    """
    points: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidMeshError(f"{path}: cannot be read ({error})") from error
    for number, line in enumerate(lines, start=1):
        words = line.split()
        try:
            if words[:1] == ["v"]:
                points.append(_point(words[1:]))
            elif words[:1] == ["f"]:
                triangles += _fan(words[1:], len(points))
        except ValueError as error:
            raise InvalidMeshError(f"{path}, line {number}: {line!r}: {error}") from error
    if not points or not triangles:
        raise InvalidMeshError(f"{path}: {len(points)} vertices and {len(triangles)} triangles")
    vertices = np.array(points)
    if not np.isfinite(vertices).all():
        raise InvalidMeshError(f"{path}: not all vertices are finite")
    if y_up:
        vertices = vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    return vertices, np.array(triangles, dtype=np.int32)


def _point(words: Sequence[str]) -> list[float]:
    if len(words) < 3:
        raise ValueError("a vertex needs three numbers")
    return [float(word) for word in words[:3]]


def _fan(words: Sequence[str], count: int) -> list[tuple[int, int, int]]:
    """The triangles of a face, all of which share its first corner."""
    first, *others = (_corner(word, count) for word in words)
    if len(others) < 2:
        raise ValueError("a face needs three corners")
    return [(first, *two) for two in pairwise(others)]


def _corner(word: str, count: int) -> int:
    """Index of a corner such as `7`, `7/1/2` or, counted from the last vertex, `-1`."""
    index = int(word.partition("/")[0])
    place = index - 1 if index > 0 else count + index
    if index == 0 or not 0 <= place < count:
        raise ValueError(f"there is no vertex {index} yet")
    return place
