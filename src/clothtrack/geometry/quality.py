"""How plausible a mesh is as a cloth, without knowing the truth: strain, crossings, crowding."""

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.spatial import cKDTree

from clothtrack.geometry.mesh import ClothMesh

_PAIRS_AT_ONCE = 1 << 19


def edge_strain(mesh_rest: ClothMesh, vertices: Float[np.ndarray, "vertices 3"]) -> float:
    """Mean absolute relative change of edge length against the rest mesh (no unit)."""
    ends = np.asarray(vertices, np.float64)[mesh_rest.edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return float(np.mean(np.abs(lengths / mesh_rest.edge_lengths - 1.0)))


def crossings(vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]) -> int:
    """Number of edges that pass through a triangle with which they share no vertex.

    Args:
        vertices: positions [m].
        faces: vertex indices per triangle.

    Returns:
        How many edges pass through at least one triangle.
    """
    return len(crossing_edges(vertices, faces)[0])


def crossing_edges(
    vertices: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
) -> tuple[Int[np.ndarray, "crossing 2"], Int[np.ndarray, "crossed 3"]]:
    """The edges that pass through a triangle with which they share no vertex.

    Args:
        vertices: positions [m].
        faces: vertex indices per triangle.

    Returns:
        The vertices of those edges, and of the triangles that they pass through.
    """
    points = np.asarray(vertices, np.float64)
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    corners, ends = points[faces], points[edges]
    centres = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centres[:, None], axis=2).max()
    reach = 0.5 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) + radius
    near = cKDTree(centres).query_ball_point(ends.mean(axis=1), reach, return_sorted=False)
    counts = np.array([len(each) for each in near])
    group = np.cumsum(counts) // _PAIRS_AT_ONCE
    crossing, crossed = np.zeros(len(edges), bool), np.zeros(len(faces), bool)
    for members in np.split(np.arange(len(edges)), np.flatnonzero(np.diff(group)) + 1):
        edge = np.repeat(members, counts[members])
        face = np.concatenate([near[each] for each in members]).astype(np.int64)
        meet = _boxes_meet(ends, corners, edge, face)
        edge, face = edge[meet], face[meet]
        apart = (faces[face][:, :, None] != edges[edge][:, None, :]).all(axis=(1, 2))
        edge, face = edge[apart], face[apart]
        through = _pass_through(ends[edge], corners[face])
        crossing[edge[through]] = True
        crossed[face[through]] = True
    return edges[crossing], faces[crossed]


def close_pairs(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    distance_m: float = 0.005,
) -> int:
    """Number of vertex pairs nearer than a distance that are not neighbours in the mesh.

    Vertices joined by an edge or by two do not count: in a fine mesh they are always near.

    Args:
        vertices: positions [m].
        faces: vertex indices per triangle.
        distance_m: pairs at or below this distance count [m].

    Returns:
        Number of unordered pairs.
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
    """Share of vertices more than a tolerance under the height of a vertex at rest on the table.

    Args:
        heights: heights of the vertices above the table [m].
        resting_height_m: height of a vertex that lies on the table [m].
        tolerance_m: how much lower does not count yet [m].

    Returns:
        A share between 0 and 1.
    """
    return float(np.mean(heights < resting_height_m - tolerance_m))


def _boxes_meet(
    ends: np.ndarray, corners: np.ndarray, edge: np.ndarray, face: np.ndarray
) -> np.ndarray:
    """Whether the boxes around edges and triangles overlap: most pairs need no closer look."""
    meet = np.ones(len(edge), bool)
    for axis in range(3):
        one, other = ends[:, :, axis], corners[:, :, axis]
        meet &= one.min(axis=1)[edge] < other.max(axis=1)[face]
        meet &= one.max(axis=1)[edge] > other.min(axis=1)[face]
    return meet


def _pass_through(ends: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether segments cross the inside of triangles (signed volumes, strictly)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    p, q = ends[:, 0], ends[:, 1]
    normal = np.cross(b - a, c - a)
    height_p = np.einsum("ij,ij->i", normal, p - a)
    height_q = np.einsum("ij,ij->i", normal, q - a)
    way = q - p
    volumes = np.stack(
        [
            np.einsum("ij,ij->i", np.cross(first - p, second - p), way)
            for first, second in ((a, b), (b, c), (c, a))
        ]
    )
    inside = (volumes > 0).all(axis=0) | (volumes < 0).all(axis=0)
    return (height_p * height_q < 0) & inside
