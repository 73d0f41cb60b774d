"""Plausibility of a cloth mesh without ground truth: strain, crossings, crowding."""

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.spatial import cKDTree

from clothtrack.geometry.crossing_search import CrossingSearch
from clothtrack.geometry.mesh import ClothMesh, sides_of


def edge_strain(mesh_rest: ClothMesh, vertices: Float[np.ndarray, "vertices 3"]) -> float:
    """Return the mean absolute relative change of edge length from the rest mesh (no unit)."""
    ends = np.asarray(vertices, np.float64)[mesh_rest.edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return float(np.mean(np.abs(lengths / mesh_rest.edge_lengths - 1.0)))


def crossings(vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]) -> int:
    """Return the number of edges that pass through a triangle with which they share no vertex."""
    return len(crossing_edges(vertices, faces)[0])


def crossing_edges(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> tuple[Int[np.ndarray, "crossing 2"], Int[np.ndarray, "crossed 3"]]:
    """Return the edges that pass through a triangle with which they share no vertex.

    Args:
        vertices: positions [m].
    """
    known = np.isfinite(vertices).all(axis=1)
    faces = np.ascontiguousarray(faces[known[faces].all(axis=1)], np.int32)
    if not len(faces):
        return np.zeros((0, 2), np.int32), faces
    return CrossingCheck(faces)(np.where(known[:, None], vertices, 0.0))


class CrossingCheck:
    """Reusable `crossing_edges` of one mesh; `faces` has at least one triangle."""

    def __init__(self, faces: Int[np.ndarray, "faces 3"]) -> None:
        self._faces = np.ascontiguousarray(faces, np.int32)
        sides = sides_of(self._faces)
        # Encode each side as one number: an order of magnitude faster than unique rows.
        count = int(self._faces.max()) + 1
        numbers = np.unique(sides[:, 0] * np.int64(count) + sides[:, 1])
        self._edges = np.stack(np.divmod(numbers, count), axis=1).astype(np.int32)
        self._search = CrossingSearch(self._edges, self._faces)

    def __call__(
        self, vertices: Float[np.ndarray, "vertices 3"]
    ) -> tuple[Int[np.ndarray, "crossing 2"], Int[np.ndarray, "crossed 3"]]:
        """Return the same as `crossing_edges` for these positions [m]."""
        if not np.isfinite(vertices).all():
            return crossing_edges(vertices, self._faces)
        edges, faces = self._search.pairs(vertices)
        return self._edges[np.unique(edges)], self._faces[np.unique(faces)]


def close_pairs(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    distance_m: float = 0.005,
) -> int:
    """Return the number of vertex pairs within a distance that are not neighbors in the mesh.

    Vertices joined by one or two edges do not count, because in a fine mesh they are always near.

    Args:
        vertices: positions [m].
        distance_m: pairs at or below this distance count [m].
    """
    count = len(vertices)
    pairs = cKDTree(vertices).query_pairs(distance_m, output_type="ndarray")
    sides = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    ones = np.ones(len(sides), np.int64)
    joined = sparse.coo_array((ones, sides.T), shape=(count, count)).tocsr()
    joined = joined + joined.T
    near = (joined + joined @ joined).tocoo()
    keys = near.row.astype(np.int64) * count + near.col
    return int((~np.isin(pairs[:, 0].astype(np.int64) * count + pairs[:, 1], keys)).sum())


def below(
    heights: Float[np.ndarray, " vertices"], resting_height_m: float, tolerance_m: float = 0.003
) -> float:
    """Return the share of vertices more than a tolerance below the resting height.

    Args:
        heights: heights of the vertices above the table [m].
        resting_height_m: height of a vertex that lies on the table [m].
        tolerance_m: depth below the resting height that does not count [m].
    """
    return float(np.mean(heights < resting_height_m - tolerance_m))
