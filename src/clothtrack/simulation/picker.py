"""Which vertices a picker holds when it closes."""

import numpy as np
from jaxtyping import Float, Int


def grasp_vertices(
    positions: Float[np.ndarray, "vertices 3"],
    tip: Float[np.ndarray, " 3"],
    radius: float,
    count: int = 1,
) -> Int[np.ndarray, " held"]:
    """Return the vertices nearest to a closing tip, nearest first.

    Args:
        positions: vertices [m], world.
        tip: the picker's tip [m], world.
        radius: how far the tip reaches [m].
        count: the most vertices that it holds.

    Returns:
        At most `count` vertex indices; none when the cloth is out of reach.
    """
    distances = np.linalg.norm(positions - np.asarray(tip), axis=1)
    nearest = np.argsort(distances, kind="stable")[:count]
    return nearest[distances[nearest] <= radius]
