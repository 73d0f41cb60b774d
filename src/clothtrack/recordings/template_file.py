"""The first mesh of a recording: a Wavefront OBJ file whose vertex order is kept."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from clothtrack.errors import (
    InvalidConfigError,
    InvalidMeshError,
    InvalidRecordingError,
    why_unreadable,
)
from clothtrack.files.atomic_write import atomic_file, write_file
from clothtrack.files.csv_table import Column, finite, read_csv
from clothtrack.geometry.mesh import ClothMesh

_TEMPLATE_SUFFIXES = (".npz", ".obj")

_CANONICAL_COLUMNS = dict.fromkeys(("x_m", "y_m", "z_m"), Column(finite, "write meters"))


def read_obj(path: Path, canonical: Path | None = None) -> ClothMesh:
    """Return the mesh of an OBJ file [m]; its polygons are cut up, its vertices keep their order.

    Only `v` and `f` lines count; remarks may be in any encoding. Vertices at the same place are
    refused instead of merged, because merging would renumber the vertices.
    """
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    for number, line in enumerate(_lines(path), start=1):
        words = line.split()
        if words and words[0] in {"v", "f"}:
            try:
                if words[0] == "v":
                    vertices.append(_vertex(words[1:]))
                else:
                    faces.extend(_triangles(words[1:], vertices))
            except ValueError as error:
                raise InvalidRecordingError(
                    f"{path}: line {number} is {line.strip()[:60]!r}: {error}; re-export the mesh"
                ) from error
    positions = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    try:
        mesh = ClothMesh(positions, np.array(faces, dtype=np.int32).reshape(-1, 3))
    except InvalidMeshError as error:
        raise InvalidMeshError(f"{path}: {error}") from error
    _refuse_loose_duplicates(path, positions)
    if canonical is None:
        return mesh
    coordinates = read_canonical(canonical)
    if len(coordinates) != len(positions):
        raise InvalidRecordingError(
            f"{canonical}: {len(coordinates)} canonical coordinates for {len(positions)} vertices "
            f"of {path.name}; write one row per vertex, in the same order"
        )
    return replace(mesh, canonical=coordinates)


def read_canonical(path: Path) -> Float[np.ndarray, "vertices 3"]:
    """Return canonical coordinates [m] from a CSV file of x_m, y_m, z_m, one row per vertex."""
    rows = [row for _, row in read_csv(path, _CANONICAL_COLUMNS)]
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def read_template(path: Path) -> ClothMesh:
    """Return a template that `write_template` has written, or any OBJ mesh [m]."""
    require_template_format(path)
    if path.suffix.lower() == ".obj":
        canonical = _canonical_path(path)
        return read_obj(path, canonical if canonical.exists() else None)
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in ("vertices", "faces", "canonical")}
    except Exception as error:
        # NumPy and zipfile refuse a damaged file with a dozen kinds of exception.
        raise InvalidRecordingError(
            f"{path}: no template can be read from it ({error}); make one with: clothtrack garment"
        ) from error
    try:
        return ClothMesh(
            arrays["vertices"].astype(np.float64),
            arrays["faces"].astype(np.int32),
            arrays["canonical"].astype(np.float64),
        )
    except InvalidMeshError as error:
        raise InvalidMeshError(f"{path}: {error}") from error


def write_template(mesh: ClothMesh, path: Path) -> None:
    """Write a garment's mesh with its canonical coordinates, whole or not at all.

    Args:
        mesh: lying flat [m].
    """
    require_template_format(path)
    canonical = mesh.vertices if mesh.canonical is None else mesh.canonical
    if path.suffix.lower() == ".obj":
        write_file(_canonical_path(path), canonical_text(canonical).encode())
        write_file(path, obj_text(mesh).encode())
        return
    with atomic_file(path) as unfinished:
        np.savez_compressed(
            unfinished, vertices=mesh.vertices, faces=mesh.faces, canonical=canonical
        )


def require_template_format(path: Path) -> None:
    """Refuse a template file with another suffix than those of templates."""
    if path.suffix.lower() not in _TEMPLATE_SUFFIXES:
        raise InvalidConfigError(f"{path}: suffix is {path.suffix!r}; a template is .npz or .obj")


def _canonical_path(path: Path) -> Path:
    return path.with_name(f"{path.stem}_canonical.csv")


def obj_text(mesh: ClothMesh) -> str:
    """Return the OBJ file of a mesh, with every digit of every coordinate."""
    return "".join(
        [f"v {x!r} {y!r} {z!r}\n" for x, y, z in mesh.vertices.astype(np.float64).tolist()]
        + [f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist()]
    )


def canonical_text(canonical: Float[np.ndarray, "vertices 3"]) -> str:
    """Return the CSV file of canonical coordinates [m]."""
    rows = [f"{x!r},{y!r},{z!r}\n" for x, y, z in canonical.astype(np.float64).tolist()]
    return "".join([",".join(_CANONICAL_COLUMNS) + "\n", *rows])


def held_problem(held: Int[np.ndarray, " held"], vertex_count: int) -> str | None:
    """Return which held vertex the template does not have; None when all exist."""
    outside = held[(held < 0) | (held >= vertex_count)]
    if not len(outside):
        return None
    return f"vertex {outside[0]} is not in the template (0 to {vertex_count - 1})"


def _lines(path: Path) -> list[str]:
    try:
        # Names and remarks may be in an older encoding; numbers are read in all of them.
        return path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        why = why_unreadable(error, "add the file or drop it from the recording")
        raise InvalidRecordingError(f"{path}: {why}") from error


def _vertex(words: list[str]) -> list[float]:
    if len(words) < 3:
        raise ValueError(f"{len(words)} numbers where x, y, z belong")
    return [float(word) for word in words[:3]]


def _triangles(words: list[str], vertices: list[list[float]]) -> list[list[int]]:
    # OBJ counts from 1, or from the end with negative numbers; "3/1/2" also names uv and normal.
    named = [int(word.split("/")[0]) for word in words]
    if len(named) < 3:
        raise ValueError("a face needs at least three vertices")
    if 0 in named:
        raise ValueError("OBJ vertices are counted from 1, so there is no vertex 0")
    corners = [index - 1 if index > 0 else len(vertices) + index for index in named]
    if len(corners) == 3 or not 0 <= min(corners) <= max(corners) < len(vertices):
        return [[corners[0], b, c] for b, c in pairwise(corners[1:])]
    points = np.array([vertices[corner] for corner in corners])
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    return [[corners[place] for place in ear] for ear in _ears(points, normal)]


def _ears(
    points: Float[np.ndarray, "corners 3"], normal: Float[np.ndarray, " 3"]
) -> list[tuple[int, int, int]]:
    """Cut a polygon into triangles that do not overlap; a convex one becomes a fan."""

    def turn(a: int, b: int, c: int) -> float:
        return float(np.cross(points[b] - points[a], points[c] - points[a]) @ normal)

    left, ears = list(range(len(points))), []
    while len(left) > 3:
        for place in range(1, len(left) + 1):
            a, b, c = (left[(place + step) % len(left)] for step in (-1, 0, 1))
            others = (one for one in left if one not in (a, b, c))
            if turn(a, b, c) > 0.0 and not any(
                min(turn(a, b, one), turn(b, c, one), turn(c, a, one)) >= 0.0 for one in others
            ):
                ears.append((a, b, c))
                left.remove(b)
                break
        else:
            raise ValueError("this face crosses itself or has no area")
    return [*ears, (left[0], left[1], left[2])]


def _refuse_loose_duplicates(path: Path, positions: Float[np.ndarray, "vertices 3"]) -> None:
    order = np.lexsort(positions.T)
    ranked = positions[order]
    same = np.flatnonzero((ranked[1:] == ranked[:-1]).all(axis=1))
    if len(same):
        first, second = sorted(order[same[0] : same[0] + 2].tolist())
        raise InvalidMeshError(
            f"{path}: vertices {first} and {second} lie at the same place "
            f"({len(same)} such pairs): the cloth would fall apart there; "
            "merge them (in Blender: merge by distance)"
        )
