"""Reward of an action: the table area that the cloth covers, seen from above.

Cloth outside the picture does not count because it can no longer be perceived or picked.
"""

import numpy as np
from jaxtyping import Float, Int

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.coverage import projected_area
from clothtrack.planning.action_space import in_picture


def coverage(
    positions: Float[np.ndarray, "candidates vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
    camera: Camera | None = None,
) -> Float[np.ndarray, " candidates"]:
    """Return the area [m^2] that each predicted cloth covers; -inf where it diverged.

    Triangles that are not wholly in the camera's picture do not count; without a camera, all count.
    """
    areas = np.full(len(positions), -np.inf)
    for index, vertices in enumerate(np.asarray(positions, dtype=np.float64)):
        if not np.isfinite(vertices).all():
            continue
        shown = in_picture(vertices, camera, 0.0)
        if not shown.any():
            areas[index] = 0.0
        else:
            areas[index] = projected_area(vertices, faces[shown[faces].all(axis=1)])
    return areas
