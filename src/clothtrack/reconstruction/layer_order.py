"""The order of overlapping cloth layers, preserved while a fit moves them.

A pair is a vertex that lies over or under a triangle of another part of the cloth. The order of all
pairs comes from one height per vertex, smoothed over neighboring pairs so that whole layers have a
consistent order.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.spatial import cKDTree

from clothtrack.geometry.mesh import ClothMesh

_SURE_M = 0.003
"""Height difference above which an order has full weight [m], about the distance of two layers."""


_MAJORITY = 1.5
"""Factor on the mean order around a pair before it is clipped to -1 to 1."""


class LayerOrder:
    """Overlapping pairs of one mesh and their order."""

    def __init__(self, mesh: ClothMesh) -> None:
        self._faces, self._count = mesh.faces, mesh.vertex_count
        i, j = mesh.edges.T.astype(np.int64)
        every = np.arange(self._count)
        ends = np.concatenate([i, j, every]), np.concatenate([j, i, every])
        ones = np.ones(len(ends[0]))
        self._joined = sparse.coo_array((ones, ends), (self._count,) * 2).tocsr()
        self._keys = np.sort(ends[0] * self._count + ends[1])
        self._rows = sparse.csr_array((0, self._count))
        self._back = self._rows.T
        self._shares = np.ones(self._count)

    def find(
        self,
        vertices: Float[np.ndarray, "vertices 3"],
        order_m: Float[np.ndarray, " vertices"],
        *,
        votes: int = 1,
    ) -> None:
        """Find the pairs of these vertices [m] and order them by these heights [m].

        Args:
            vertices: vertex positions [m].
            order_m: heights [m]; the higher one of a pair is on top.
        """
        vertex, face, blend = self._overlaps(vertices)
        corners = self._faces[face]
        above = order_m[vertex] - (order_m[corners] * blend).sum(axis=1)
        sign = self._agreed(vertex, corners, blend, np.clip(above / _SURE_M, -1.0, 1.0), votes)
        pairs = np.arange(len(vertex))
        # One row per pair: signed height of the vertex over the triangle, positive in their order.
        columns = np.column_stack([vertex, corners]).ravel()
        values = (sign[:, None] * np.column_stack([np.ones(len(vertex)), -blend])).ravel()
        self._rows = sparse.csr_array(
            (values, columns, 4 * np.append(pairs, len(pairs))), (len(pairs), self._count)
        )
        self._back = self._rows.T
        shares = np.bincount(columns, np.abs(values), self._count)
        self._shares = np.maximum(shares, 1.0)

    def apart(
        self, heights: Float[np.ndarray, " vertices"], gap_m: float, passes: int
    ) -> Float[np.ndarray, " vertices"]:
        """Return heights [m] with the layers of each pair moved towards an ordered gap [m]."""
        if not self._rows.shape[0]:
            return heights
        for _ in range(passes):
            short = np.maximum(gap_m - self._rows @ heights, 0.0)
            heights = heights + 0.5 * (self._back @ short) / self._shares
        return heights

    def _overlaps(
        self, vertices: Float[np.ndarray, "vertices 3"]
    ) -> tuple[Int[np.ndarray, " pairs"], Int[np.ndarray, " pairs"], Float[np.ndarray, "pairs 3"]]:
        """Return vertices inside triangles of other parts seen from above, with barycentrics."""
        level = vertices[:, :2]
        corners = level[self._faces]
        middles = corners.mean(axis=1)
        reach = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
        found = cKDTree(level).query_ball_point(middles, reach, return_sorted=False)
        counts = np.fromiter(map(len, found), np.int64, len(found))
        vertex = np.concatenate(found).astype(np.int64)
        face = np.repeat(np.arange(len(found)), counts)
        # Barycentric coordinates are linear in the position, so six numbers per triangle suffice.
        first, sides = corners[:, 0], corners[:, 1:] - corners[:, :1]
        area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
        area = np.where(np.abs(area) < 1e-14, np.inf, area)
        table = np.column_stack([first, sides.reshape(-1, 4) / area[:, None]])[face]
        x, y = (level[vertex] - table[:, :2]).T
        second = x * table[:, 5] - y * table[:, 4]
        third = y * table[:, 2] - x * table[:, 3]
        inside = (second >= 0.0) & (third >= 0.0) & (second + third <= 1.0)
        inside[inside] = ~self._next_to(vertex[inside], face[inside])
        blend = np.column_stack([1.0 - second - third, second, third])[inside]
        return vertex[inside], face[inside], blend

    def _next_to(
        self, vertex: Int[np.ndarray, " pairs"], face: Int[np.ndarray, " pairs"]
    ) -> Bool[np.ndarray, " pairs"]:
        """Return whether the vertex is a corner of its triangle or adjacent to one."""
        asked = vertex[:, None] * self._count + self._faces[face]
        place = np.minimum(np.searchsorted(self._keys, asked), len(self._keys) - 1)
        return (self._keys[place] == asked).any(axis=1)

    def _agreed(
        self,
        vertex: Int[np.ndarray, " pairs"],
        corners: Int[np.ndarray, "pairs 3"],
        blend: Float[np.ndarray, "pairs 3"],
        above: Float[np.ndarray, " pairs"],
        votes: int,
    ) -> Float[np.ndarray, " pairs"]:
        """Return 1 or -1 for each pair, the majority of itself and its neighboring pairs."""
        if not len(vertex):
            return above
        ends, shape = (np.repeat(vertex, 3), corners.ravel()), (self._count,) * 2
        said = sparse.coo_array(((above[:, None] * blend).ravel(), ends), shape).tocsr()
        said = said - said.T
        if votes > 1:
            there = sparse.coo_array((np.ones(len(ends[0])), ends), shape).tocsr()
            there = there + there.T
            there.data[:] = 1.0
            rows, columns = there.tocoo().coords
            number = _entries(self._joined @ there @ self._joined, rows, columns)
            for _ in range(votes - 1):
                total = _entries(self._joined @ said @ self._joined, rows, columns)
                # A little more than the mean, so that a large majority keeps its full weight.
                mean = np.clip(_MAJORITY * total / number, -1.0, 1.0)
                said = sparse.coo_array((mean, (rows, columns)), shape).tocsr()
        together = _entries(self._joined @ said @ self._joined, *ends).reshape(-1, 3)
        return np.where((together * blend).sum(axis=1) >= 0.0, 1.0, -1.0)


def _entries(
    matrix: sparse.csr_array, rows: Int[np.ndarray, " asked"], columns: Int[np.ndarray, " asked"]
) -> Float[np.ndarray, " asked"]:
    """Return entries of a sparse matrix, 0 where it stores none."""
    matrix.sort_indices()
    count = matrix.shape[1]
    of_row = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    keys = of_row * np.int64(count) + matrix.indices
    asked = rows * np.int64(count) + columns
    place = np.minimum(np.searchsorted(keys, asked), len(keys) - 1)
    return np.where(keys[place] == asked, matrix.data[place], 0.0)
