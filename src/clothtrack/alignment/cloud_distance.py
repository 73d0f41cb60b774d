"""How far a mesh is from a cloud, and which points of a cloud can be of this cloth."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from clothtrack.recordings.point_cloud import Observation

_MOST_CUBES = 1 << 20
"""Vertices that are spread over more cubes than this keep every point beside them."""


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
    """Return points that are in one cube of a grid with some vertex: no farther than its diagonal.

    Most points of a tracked cloth are, and need no search.
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
    # Axis by axis: what is done along rows of three is slow.
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
    """Return at least the points [m] that have a vertex within reach, and few others.

    No search is needed.

    Those are in the cube of a grid that holds a vertex, or in one beside it.
    """
    if not len(points) or not len(vertices):
        return points[:0]
    # A little wider than the reach: rounding must not lose a point.
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
    """Two-way Chamfer [m^2] of visible vertices against a cloud, unobservable vertices left out.

    A vertex counts towards vertex-to-cloud only where the sensor could have answered.
    """
    if not visible.any() or not len(observation.points):
        return np.inf
    seen = positions[visible]
    from_cloud = cKDTree(seen).query(observation.points)[0]
    answered = seen[~observation.unobservable(seen)]
    from_mesh = cKDTree(observation.points).query(answered)[0] if len(answered) else np.zeros(1)
    return float(np.mean(from_cloud**2) + np.mean(from_mesh**2))
