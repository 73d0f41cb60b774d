"""Self-intersections of a mesh: its crossings, joined into contours.

A crossing is an edge that passes through a triangle. If two triangles cut each other, their line of
intersection runs from one crossing to another. A contour is a connected set of crossings. P. Volino
and N. Magnenat-Thalmann, "Resolving surface collisions through intersection contour minimization"
(SIGGRAPH 2006, doi:10.1145/1141911.1142007), give the move of a crossing that shortens its contour.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from clothtrack.geometry.crossing_search import CrossingSearch
from clothtrack.geometry.mesh import ClothMesh, sides_of

STEEPEST = 0.2
"""Lower limit of the sine of the angle between edge and triangle. If an edge nearly lies in the
triangle, the contour would move very far with any move of the edge."""


@dataclass(frozen=True, eq=False)
class Contours:
    """Self-intersections of a mesh.

    Attributes:
        edges: index of the edge of each crossing.
        faces: index of the triangle that it passes through.
        along: position on the edge, 0 at its first vertex, 1 at its second.
        within: barycentric coordinates in the triangle.
        shortening: move of the edge relative to the triangle that shortens the contour: 2 m of
            contour per meter along its length.
        contour: index of the contour of the crossing.
        sides: 1 if the edge belongs to the contour's first sheet, -1 if it belongs to the second;
            0 if the contour does not have two sheets (it turns back at a vertex).
    """

    edges: Int[np.ndarray, " crossings"]
    faces: Int[np.ndarray, " crossings"]
    along: Float[np.ndarray, " crossings"]
    within: Float[np.ndarray, "crossings 3"]
    normals: Float[np.ndarray, "crossings 3"]
    shortening: Float[np.ndarray, "crossings 3"]
    contour: Int[np.ndarray, " crossings"]
    sides: Int[np.ndarray, " crossings"]

    def __len__(self) -> int:
        """Return the number of crossings."""
        return len(self.edges)

    @property
    def count(self) -> int:
        """Number of contours."""
        return int(self.contour.max(initial=-1)) + 1

    @property
    def crossing_edges(self) -> int:
        """Number of edges that pass through a triangle."""
        return len(np.unique(self.edges))


class SelfIntersection:
    """Search for the contours of one mesh at any vertex positions.

    Args:
        mesh: the triangles; its vertex positions do not matter.
    """

    def __init__(self, mesh: ClothMesh, *, device: str = "cpu") -> None:
        self.mesh, self.device = mesh, device
        self.edges = np.ascontiguousarray(mesh.edges, np.int32)
        self.edge_faces = _faces_of_edges(mesh)
        faces = np.ascontiguousarray(mesh.faces, np.int32)
        self._search = CrossingSearch(self.edges, faces, device=device)

    def pairs(
        self, vertices: Float[np.ndarray, "vertices 3"]
    ) -> tuple[Int[np.ndarray, " crossings"], Int[np.ndarray, " crossings"]]:
        """Return edges and the triangles that they pass through, for vertices at positions [m]."""
        return self._search.pairs(vertices)

    def contours(self, vertices: Float[np.ndarray, "vertices 3"]) -> Contours:
        """Return all crossings, joined into contours, for vertices at positions [m]."""
        edge, face = self.pairs(vertices)
        points = np.asarray(vertices, np.float64)
        a, b = points[self.edges[edge, 0]], points[self.edges[edge, 1]]
        corners = points[self.mesh.faces[face]]
        normals = _normals(corners)
        above = np.einsum("ci,ci->c", a - corners[:, 0], normals)
        below = np.einsum("ci,ci->c", b - corners[:, 0], normals)
        # An edge that lies in the triangle's plane up to rounding counts as crossing in its middle.
        rise = above - below
        along = np.where(rise == 0.0, 0.5, above / np.where(rise == 0.0, 1.0, rise))
        contour, sides = self._joined(edge, face)
        return Contours(
            edge,
            face,
            along,
            _barycentric(a + along[:, None] * (b - a), corners),
            normals,
            self._shortening(points, edge, normals),
            contour,
            sides,
        )

    def _shortening(
        self,
        points: Float[np.ndarray, "vertices 3"],
        edge: Int[np.ndarray, " crossings"],
        normals: Float[np.ndarray, "crossings 3"],
    ) -> Float[np.ndarray, "crossings 3"]:
        """Return Volino's G: R - 2 (E.R) / (E.N) N, over the triangles beside the edge.

        E is the edge, N the normal of the triangle that it passes through, R the direction in
        which the line of intersection leaves the crossing into a triangle beside the edge.
        """
        start = points[self.edges[edge, 0]]
        direction = _unit(points[self.edges[edge, 1]] - start)
        steep = np.einsum("ci,ci->c", direction, normals)
        steep = np.where(steep < 0.0, -1.0, 1.0) * np.maximum(np.abs(steep), STEEPEST)
        total = np.zeros_like(normals)
        for beside in range(2):
            face = self.edge_faces[edge, beside]
            corners = points[self.mesh.faces[face]]
            line = _unit(np.cross(_normals(corners), normals))
            inward = corners.mean(axis=1) - start
            inward -= np.einsum("ci,ci->c", inward, direction)[:, None] * direction
            line *= np.where(np.einsum("ci,ci->c", line, inward) < 0.0, -1.0, 1.0)[:, None]
            slide = np.einsum("ci,ci->c", direction, line) / steep
            total += np.where(face[:, None] >= 0, line - 2.0 * slide[:, None] * normals, 0.0)
        return total

    def _joined(
        self, edge: Int[np.ndarray, " crossings"], face: Int[np.ndarray, " crossings"]
    ) -> tuple[Int[np.ndarray, " crossings"], Int[np.ndarray, " crossings"]]:
        """Return contour and side of each crossing.

        Two triangles that cut each other join the crossings at the ends of their line. Each
        crossing is in the graph twice, once with its edge on the first sheet and once on the
        second, so that a contour with two sheets splits into two mirror images.
        """
        count = len(edge)
        number = np.tile(np.arange(count), 2)
        beside = self.edge_faces[edge].T.reshape(-1)
        other = np.tile(face, 2)
        known = beside >= 0
        number, beside, other = number[known], beside[known], other[known]
        first = beside < other
        key = np.minimum(beside, other) * np.int64(len(self.mesh.faces)) + np.maximum(beside, other)
        # Each pair of triangles also has two nodes, with its lower triangle on either sheet.
        _, pair = np.unique(key, return_inverse=True)
        pairs = int(pair.max(initial=-1)) + 1
        here = np.concatenate([number, number + count])
        there = np.concatenate([pair + pairs * ~first, pair + pairs * first])
        graph = sparse.coo_array(
            (np.ones(len(here), np.int8), (here, 2 * count + there)),
            shape=(2 * count + 2 * pairs, 2 * count + 2 * pairs),
        )
        _, label = connected_components(graph, directed=False)
        one, mirrored = label[:count], label[count : 2 * count]
        contour = np.unique(np.minimum(one, mirrored), return_inverse=True)[1]
        return contour, np.sign(mirrored - one)


def _faces_of_edges(mesh: ClothMesh) -> Int[np.ndarray, "edges 2"]:
    """Return the two triangles at each edge; -1 outside an open edge."""
    _, edge = np.unique(sides_of(mesh.faces), axis=0, return_inverse=True)
    order = np.argsort(edge, kind="stable")
    edge, face = edge[order], order // 3
    again = np.concatenate([[False], edge[1:] == edge[:-1]])
    beside = np.full((len(mesh.edges), 2), -1, np.int64)
    beside[edge, again.astype(int)] = face
    return beside


def _normals(corners: Float[np.ndarray, "faces 3 3"]) -> Float[np.ndarray, "faces 3"]:
    return _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def _unit(vectors: Float[np.ndarray, "vectors 3"]) -> Float[np.ndarray, "vectors 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


def _barycentric(
    points: Float[np.ndarray, "points 3"], corners: Float[np.ndarray, "points 3 3"]
) -> Float[np.ndarray, "points 3"]:
    """Return the barycentric coordinates of points in their triangles."""
    apart = corners - points[:, None]
    areas = np.linalg.norm(np.cross(apart[:, [1, 2, 0]], apart[:, [2, 0, 1]], axis=2), axis=2)
    return areas / np.maximum(areas.sum(axis=1, keepdims=True), 1e-18)
