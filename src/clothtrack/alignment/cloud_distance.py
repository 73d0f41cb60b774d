"""Distance between a mesh and a cloud, and selection of cloud points near the mesh."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from clothtrack.recordings.point_cloud import Observation

_MOST_CUBES = 1 << 20
"""If the vertices extend over more cubes than this, `beside` keeps every point."""


def within_reach(
    points: Float[np.ndarray, "points 3"], vertices: Float[np.ndarray, "vertices 3"], reach_m: float
) -> Float[np.ndarray, "near_points 3"]:
    """Return the points [m] that have a vertex within reach."""
    if not len(points) or not len(vertices):
        return points[:0]
    near = _share_a_cube(points, vertices, reach_m / np.sqrt(3.0))
    rest = np.flatnonzero(~near)
    if len(rest):
        distance = cKDTree(vertices).query(points[rest], distance_upper_bound=reach_m)[0]
        near[rest] = np.isfinite(distance)
    return points[near]


def _share_a_cube(
    points: Float[np.ndarray, "points 3"], vertices: Float[np.ndarray, "vertices 3"], side_m: float
) -> Bool[np.ndarray, " points"]:
    """Return points that share a grid cube with a vertex, at most its diagonal away.

    This holds for most points of a tracked cloth, which then need no search.
    """
    origin = vertices.min(axis=0)
    cells = np.floor((vertices - origin) / side_m).astype(np.int64)
    filled = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    filled[tuple(cells.T)] = True
    return _in_filled_cubes(points, filled, origin, side_m)


def _in_filled_cubes(
    points: Float[np.ndarray, "points 3"],
    filled: Bool[np.ndarray, "width depth height"],
    origin: Float[np.ndarray, " 3"],
    side_m: float,
) -> Bool[np.ndarray, " points"]:
    # Process axis by axis, because operations along rows of three are slow.
    index = [
        np.floor((axis - start) / side_m) for axis, start in zip(points.T, origin, strict=True)
    ]
    inside = np.ones(len(points), dtype=bool)
    for axis, count in zip(index, filled.shape, strict=True):
        inside &= (axis >= 0) & (axis < count)
    near = np.flatnonzero(inside)
    inside[near] = filled[tuple(axis[near].astype(np.int64) for axis in index)]
    return inside


def beside(
    points: Float[np.ndarray, "points 3"], vertices: Float[np.ndarray, "vertices 3"], reach_m: float
) -> Float[np.ndarray, "near_points 3"]:
    """Return all points [m] that have a vertex within reach, and few others, without a search.

    The result contains the points in a grid cube with a vertex or in a neighboring cube.
    """
    if not len(points) or not len(vertices):
        return points[:0]
    # Use a slightly larger reach, so that rounding does not lose a point.
    side_m = 1.001 * reach_m
    origin = vertices.min(axis=0) - side_m
    cells = np.floor((vertices - origin) / side_m).astype(np.int64)
    shape = cells.max(axis=0) + 2
    if not shape.prod(dtype=np.float64) <= _MOST_CUBES:
        return points
    filled = np.zeros(shape, dtype=bool)
    for offset in np.ndindex(3, 3, 3):
        filled[tuple((cells + offset - 1).T)] = True
    return points[_in_filled_cubes(points, filled, origin, side_m)]


def masked_chamfer(
    positions: Float[np.ndarray, "vertices 3"], visible: np.ndarray, observation: Observation
) -> float:
    """Return the two-way Chamfer distance [m^2] between visible vertices and a cloud.

    Unobservable vertices do not count in the vertex-to-cloud direction.
    """
    if not visible.any() or not len(observation.points):
        return np.inf
    seen = positions[visible]
    from_cloud = cKDTree(seen).query(observation.points)[0]
    answered = seen[~observation.unobservable(seen)]
    from_mesh = cKDTree(observation.points).query(answered)[0] if len(answered) else np.zeros(1)
    return float(np.mean(from_cloud**2) + np.mean(from_mesh**2))
