"""Description of where a part of the cloth lies in the picture."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from clothtrack.geometry.camera import Camera

MIDDLE = 0.25
"""Offset from the middle of the cloth, over its half extent, up to which a part has no side."""


def place_of(
    vertices: Float[np.ndarray, "vertices 3"],
    part: Bool[np.ndarray, " vertices"],
    cameras: Sequence[Camera],
) -> str:
    """Return where a part of the cloth lies in the first camera's picture, such as "at the left".

    Args:
        vertices: vertices of the whole cloth [m, world].
    """
    points = np.asarray(vertices, np.float64)
    whole = cameras[0].project(points)[0] if cameras else points[:, :2] * (1, -1)
    middle, extent = whole.mean(axis=0), np.ptp(whole, axis=0).max() / 2
    across, down = (whole[part].mean(axis=0) - middle) / max(float(extent), 1e-9)
    sides = []
    if abs(down) > MIDDLE:
        sides.append("bottom" if down > 0 else "top")
    if abs(across) > MIDDLE:
        sides.append("right" if across > 0 else "left")
    return f"at the {' '.join(sides)}" if sides else "in the middle"
