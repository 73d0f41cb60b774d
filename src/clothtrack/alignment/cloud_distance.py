"""How far a mesh is from a cloud, and which points of a cloud can be of this cloth."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from clothtrack.recordings.point_cloud import Observation


def within_reach(
    points: Float[np.ndarray, "points 3"], vertices: Float[np.ndarray, "vertices 3"], reach_m: float
) -> Float[np.ndarray, "near_points 3"]:
    """The points [m] that have a vertex within reach: what lies farther is not this cloth."""
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
    """Points that are in one cube of a grid with some vertex: no farther than its diagonal.

    Most points of a tracked cloth are, and need no search.
    """
    origin = vertices.min(axis=0)
    cells = np.floor((vertices - origin) / side_m).astype(np.int64)
    shape = cells.max(axis=0) + 1
    filled = np.zeros(shape, dtype=bool)
    filled[tuple(cells.T)] = True
    index = np.floor((points - origin) / side_m)
    inside = ((index >= 0) & (index < shape)).all(axis=1)
    sharing = np.zeros(len(points), dtype=bool)
    sharing[inside] = filled[tuple(index[inside].astype(np.int64).T)]
    return sharing


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
