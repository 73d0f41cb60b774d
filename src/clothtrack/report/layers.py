"""Layer number of each vertex in a folded cloth, used to draw layers apart."""

from itertools import chain

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from clothtrack.geometry.mesh import ClothMesh

SMOOTHING_ROUNDS = 6
"""Rounds of averaging over neighbors, which turn a jump of the rank into a slope."""

ASIDE = 0.003
"""Offset from a vertex at which layers are counted, as a share of the length of an edge."""


class Layers:
    """Counter of the layers under every vertex of one mesh in any pose."""

    def __init__(self, mesh: ClothMesh, axis: Float[np.ndarray, " 3"]) -> None:
        """Prepare for a mesh whose layers are stacked along `axis`, a unit vector."""
        self._faces = np.asarray(mesh.faces)
        self._axis = np.asarray(axis, np.float64)
        first = np.cross(self._axis, np.eye(3)[int(np.argmin(np.abs(self._axis)))])
        first /= np.linalg.norm(first)
        self._across = np.stack([first, np.cross(self._axis, first)], axis=1)
        # Vertices of two equal layers may coincide, so test a point offset into a triangle.
        self._aside = ASIDE * float(np.median(mesh.edge_lengths)) * np.array([0.83, 0.56])
        count, ends = mesh.vertex_count, mesh.edges
        both = np.concatenate([ends, ends[:, ::-1], np.repeat(np.arange(count)[:, None], 2, 1)])
        weights = csr_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(count, count))
        self._averages = weights.multiply(1.0 / weights.sum(axis=1)[:, None]).tocsr()

    def ranks(self, vertices: Float[np.ndarray, "vertices 3"]) -> Float[np.ndarray, " vertices"]:
        """Return the number of layers under each vertex, with slopes where it changes."""
        ranks = self.counts(vertices)
        for _ in range(SMOOTHING_ROUNDS):
            ranks = self._averages @ ranks
        return ranks

    def counts(self, vertices: Float[np.ndarray, "vertices 3"]) -> Float[np.ndarray, " vertices"]:
        """Return the number of triangles under each vertex, except those it belongs to."""
        vertices = np.asarray(vertices, np.float64)
        flat, height = vertices @ self._across, vertices @ self._axis
        face, vertex = self._near(flat)
        corners = self._faces[face]
        others = (corners != vertex[:, None]).all(axis=1)
        face, vertex, corners = face[others], vertex[others], corners[others]
        a, b, c = (flat[corners[:, k]] for k in range(3))
        place = flat[vertex] + self._aside
        double_area = _wedge(b - a, c - a)
        upright = np.abs(double_area) < 1e-12  # a triangle on its edge covers nothing
        double_area[upright] = np.inf
        of_b = _wedge(place - a, c - a) / double_area
        of_c = _wedge(b - a, place - a) / double_area
        of_a = 1.0 - of_b - of_c
        inside = ~upright & (of_a > 0) & (of_b > 0) & (of_c > 0)
        weights = np.stack([of_a, of_b, of_c], axis=1)[inside]
        under = (weights * height[corners[inside]]).sum(axis=1) < height[vertex[inside]]
        return np.bincount(vertex[inside][under], minlength=len(vertices)).astype(np.float64)

    def _near(self, flat: Float[np.ndarray, "vertices 2"]) -> tuple[np.ndarray, np.ndarray]:
        """Return pairs of a face and a vertex that may lie over or under it."""
        corners = flat[self._faces]
        centers = corners.mean(axis=1)
        radii = np.linalg.norm(corners - centers[:, None], axis=2).max(axis=1)
        reach = 1.01 * radii + np.linalg.norm(self._aside)
        near = cKDTree(flat).query_ball_point(centers, reach, return_sorted=False)
        counts = np.array([len(one) for one in near])
        vertex = np.fromiter(chain.from_iterable(near), np.int64, count=int(counts.sum()))
        return np.repeat(np.arange(len(near)), counts), vertex


def _wedge(
    a: Float[np.ndarray, "pairs 2"], b: Float[np.ndarray, "pairs 2"]
) -> Float[np.ndarray, " pairs"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
