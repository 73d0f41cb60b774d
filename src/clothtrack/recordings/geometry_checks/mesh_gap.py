"""The distance of a mesh from the cloud of its frame, for a template and for a first mesh."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from clothtrack.geometry.closest_point import distance_to_mesh
from clothtrack.geometry.visibility import visible_vertices
from clothtrack.recordings.point_cloud import Observation

LARGEST_GAP_M = 0.02
"""Distance of a first mesh from its cloud (root mean square) [m] above which it is not the mesh of
the observed cloth. On right recordings it is 1 to 6 mm; a pick reaches 30 mm."""

_LEAST_OBSERVABLE = 0.3
"""Share of the visible vertices that must be observable for their distances to count."""


def mesh_gap_m(
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    observation: Observation,
    *,
    device: str = "cpu",
) -> float | None:
    """Return the distance of a mesh from an observation, root mean square of both directions [m].

    The directions are from the cloud's points to the surface, and from the visible vertices to the
    cloud, except those where nothing could be measured.

    Args:
        vertices: vertices of the mesh, in the world [m].

    Returns:
        The distance; that of the points alone if too little of the mesh is observable; None if
        that is so because points were cut away, as clouds without the table say nothing about a
        cloth that lies on it.
    """
    vertices = np.asarray(vertices, np.float64)
    seen = visible_vertices(vertices, faces, observation.cameras, device=device)
    if not seen.any():
        # The mesh is outside of every picture, while the cloud is inside: judge all vertices.
        seen = np.ones(len(vertices), dtype=bool)
        judged = seen
    else:
        judged = seen & ~observation.unobservable(vertices)
    unjudged = judged.sum() < _LEAST_OBSERVABLE * seen.sum()
    cut_away = observation.lowest_height_m is not None or observation.tool_clearance_m > 0
    if not len(observation.points) or (unjudged and cut_away):
        return None
    there = distance_to_mesh(observation.points, vertices, faces)
    if unjudged:
        return float(np.sqrt(np.mean(there**2)))
    back, _ = cKDTree(observation.points).query(vertices[judged])
    return float(np.sqrt(0.5 * (np.mean(there**2) + np.mean(back**2))))
