"""Mesh files that other programs read and write, too: OBJ, PLY, STL or GLB, in meters."""

from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidMeshError
from clothtrack.files.atomic_write import atomic_file
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.template_file import read_obj

READ_SUFFIXES = (".obj", ".ply", ".stl")
WRITTEN_SUFFIXES = (*READ_SUFFIXES, ".glb")

_Y_UP = trimesh.transformations.rotation_matrix(-0.5 * np.pi, [1.0, 0.0, 0.0])
"""Transform from our world with z up to that of glTF with y up."""

_VERTEX_ERROR = "expected_error_m"
"""Property of a PLY's vertices: the expected distance from their true positions [m]."""


def require_mesh_format(path: Path, suffixes: tuple[str, ...] = WRITTEN_SUFFIXES) -> None:
    """Refuse a mesh file whose suffix is not among those written, or read."""
    if path.suffix.lower() not in suffixes:
        choice = f"{', '.join(suffixes[:-1])} or {suffixes[-1]}"
        raise InvalidConfigError(f"{path}: suffix is {path.suffix!r}; choose {choice}")


def write_mesh(
    mesh: ClothMesh, path: Path, *, expected_error_m: Float[np.ndarray, " vertices"] | None = None
) -> None:
    """Write a mesh [m] in the format of its suffix, whole or not at all.

    The order of the vertices is kept. A GLB has a node that turns z up to y up, as glTF requires.

    Args:
        expected_error_m: expected error of each vertex [m]; only a PLY keeps it, as a property of
            its vertices.
    """
    require_mesh_format(path)
    errors = (
        {} if expected_error_m is None else {_VERTEX_ERROR: expected_error_m.astype(np.float32)}
    )
    written = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False, vertex_attributes=errors)
    with atomic_file(path) as temporary:
        if path.suffix.lower() == ".glb":
            scene = trimesh.Scene()
            scene.add_geometry(written, node_name="cloth", geom_name="cloth", transform=_Y_UP)
            scene.export(temporary)
        else:
            written.export(temporary)


def read_vertex_errors(path: Path) -> Float[np.ndarray, " vertices"] | None:
    """Return the expected error of each vertex [m] that a PLY keeps; None if there is none."""
    if path.suffix.lower() != ".ply":
        return None
    try:
        with path.open("rb") as file:
            loaded = trimesh.load_mesh(file, file_type="ply", process=False)
        vertices = loaded.metadata["_ply_raw"]["vertex"]["data"]
        return np.asarray(vertices[_VERTEX_ERROR], np.float64).reshape(-1)
    except (KeyError, ValueError, IndexError):
        return None
    except (OSError, TypeError, AttributeError) as error:
        raise InvalidMeshError(f"{path}: cannot be read ({error}); write it again") from error


def read_mesh(path: Path) -> ClothMesh:
    """Read a mesh [m] from an OBJ, PLY or STL file.

    STL has no shared vertices, so vertices at the same place are merged.
    """
    require_mesh_format(path, READ_SUFFIXES)
    if path.suffix.lower() == ".obj":
        return read_obj(path)
    kind = path.suffix.lower().removeprefix(".")
    try:
        with path.open("rb") as file:
            loaded = trimesh.load_mesh(file, file_type=kind, process=kind == "stl")
        return ClothMesh(
            np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int64)
        )
    except InvalidMeshError as error:
        raise InvalidMeshError(f"{path}: {error}") from error
    except (OSError, ValueError, IndexError, KeyError, TypeError, AttributeError) as error:
        raise InvalidMeshError(
            f"{path}: cannot be read as {kind.upper()} ({error}); write the mesh again"
        ) from error
