"""The triangle mesh of a cloth: vertex positions and topology.

Public arrays are in meters. Vertices keep their index: vertex 17 is the same material point in
every frame, in the files and in the report.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from clothtrack.errors import InvalidMeshError

FARTHEST_M = 1e5
"""Largest allowed distance of a vertex from the origin [m], even if the units are wrong."""


@dataclass(frozen=True, eq=False)
class ClothMesh:
    """Manifold triangle mesh, possibly open (hem, neck) and in one or several pieces.

    Attributes:
        vertices: positions [m], world frame or the garment's own.
        faces: vertex indices, one row per triangle.
        canonical: canonical coordinates [m] of each vertex. The same material point has the same
            canonical coordinates in every mesh of the garment, for any triangulation.
    """

    vertices: Float[np.ndarray, "vertices 3"]
    faces: Int[np.ndarray, "faces 3"]
    canonical: Float[np.ndarray, "vertices 3"] | None = None

    def __post_init__(self) -> None:
        """Reject arrays that cannot be a cloth.

        Raises:
            InvalidMeshError: with the first offending vertex, face or edge.
        """
        _check_arrays(self.vertices, self.faces)
        _check_surface(self)

    def __repr__(self) -> str:
        """Return one line, without the positions."""
        return f"{type(self).__name__}({self.vertex_count} vertices, {len(self.faces)} faces)"

    @property
    def vertex_count(self) -> int:
        """Number of vertices."""
        return len(self.vertices)

    @cached_property
    def edges(self) -> Int[np.ndarray, "edges 2"]:
        """Every edge once, lower vertex index first, sorted."""
        return np.unique(sides_of(self.faces), axis=0).astype(np.int32)

    @cached_property
    def edge_lengths(self) -> Float[np.ndarray, " edges"]:
        """Length of each edge [m] at the present vertices."""
        ends = self.vertices[self.edges]
        return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)

    @cached_property
    def vertex_areas(self) -> Float[np.ndarray, " vertices"]:
        """A third of the area [m^2] of the triangles around each vertex; sums to the mesh area."""
        corners = self.vertices[self.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.zeros(self.vertex_count)
        np.add.at(areas, self.faces.ravel(), np.repeat(np.linalg.norm(normals, axis=1) / 6.0, 3))
        return areas

    @cached_property
    def opposite_pairs(self) -> Int[np.ndarray, "interior_edges 2"]:
        """The two vertices opposite each other across each interior edge (bending pairs)."""
        keys, opposite = sides_of(self.faces), self.faces[:, [2, 0, 1]].reshape(-1)
        order = np.lexsort((keys[:, 1], keys[:, 0]))
        keys, opposite = keys[order], opposite[order]
        shared = np.flatnonzero((keys[1:] == keys[:-1]).all(axis=1))
        return np.stack([opposite[shared], opposite[shared + 1]], axis=1).astype(np.int32)

    def with_vertices(self, vertices: Float[np.ndarray, "vertices 3"]) -> "ClothMesh":
        """Return the same cloth with other vertex positions."""
        return replace(self, vertices=np.asarray(vertices))

    def scaled(self, factor: float) -> "ClothMesh":
        """Return the cloth scaled by a factor, including its canonical coordinates."""
        canonical = None if self.canonical is None else np.asarray(self.canonical) * factor
        return replace(self, vertices=np.asarray(self.vertices) * factor, canonical=canonical)


def sides_of(faces: Int[np.ndarray, "faces 3"]) -> Int[np.ndarray, "sides 2"]:
    """Return the three sides of each face, lower vertex index first."""
    return np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)


def _check_arrays(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Check shapes, types, and the ranges of meters and indices."""
    for name, array, kinds in (("vertices", vertices, "fiu"), ("faces", faces, "iu")):
        if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in kinds:
            raise InvalidMeshError(
                f"{name} are an array of shape {array.shape} and type {array.dtype}; they must be "
                "rows of three numbers"
            )
    if len(faces) == 0:
        raise InvalidMeshError("the mesh has no triangle; a cloth needs at least one")
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise InvalidMeshError(
            f"vertex {bad[0]} is {vertices[bad[0]].tolist()}: {len(bad)} of {len(vertices)} "
            "vertices are not finite; repair or re-export the mesh"
        )
    if (farthest := float(np.abs(vertices).max(initial=0.0))) > FARTHEST_M:
        raise InvalidMeshError(
            f"a vertex is {farthest:.1e} m from the origin (at most {FARTHEST_M:g} m); scale the "
            "mesh to meters"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InvalidMeshError(
            f"a face names vertex {int(faces.max() if faces.min() >= 0 else faces.min())}, "
            f"but vertices run from 0 to {len(vertices) - 1}"
        )


def _check_surface(mesh: ClothMesh) -> None:
    """Check that the triangles are a manifold surface without loose vertices."""
    vertices, faces = mesh.vertices, mesh.faces
    twice = np.flatnonzero(
        (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    )
    if len(twice):
        raise InvalidMeshError(
            f"face {twice[0]} is {faces[twice[0]].tolist()}: it uses one vertex twice; remove it"
        )
    edges, counts = np.unique(sides_of(faces), axis=0, return_counts=True)
    if counts.max() > 2:
        worst = int(counts.argmax())
        raise InvalidMeshError(
            f"edge {edges[worst].tolist()} belongs to {counts[worst]} triangles; a cloth has at "
            "most 2 at an edge (non-manifold): split the mesh there or drop the duplicate faces"
        )
    unused = np.setdiff1d(np.arange(len(vertices)), faces)
    if len(unused):
        raise InvalidMeshError(
            f"vertex {unused[0]} belongs to no triangle ({len(unused)} such vertices); "
            "remove loose vertices"
        )
    lengths = np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1)
    if lengths.min() < 1e-6:
        worst = int(lengths.argmin())
        raise InvalidMeshError(
            f"edge {edges[worst].tolist()} is {lengths[worst]:.1e} m long (at least 1e-6 m): "
            "duplicate vertices; merge them"
        )
    if mesh.canonical is None:
        return
    if len(mesh.canonical) != len(vertices):
        raise InvalidMeshError(
            f"{len(mesh.canonical)} canonical coordinates for {len(vertices)} vertices"
        )
    # Convert first, because the limit is too large for half precision.
    distances = np.abs(mesh.canonical.astype(float))
    if (distances > FARTHEST_M).any():
        raise InvalidMeshError(
            f"a canonical coordinate is {np.nanmax(distances):.1e} m (at most "
            f"{FARTHEST_M:g} m); scale the mesh to meters"
        )
