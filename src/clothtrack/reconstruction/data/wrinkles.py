"""Adds fine wrinkles, like those of washed cotton, to a flat or folded cloth.

A wrinkle is a ridge of a few millimeters that runs for some distance and fades. The whole stack
rises with it, so that layers keep their order. Cloth is drawn in from both sides by the length that
the ridge takes up, so that edges keep their lengths.
"""

import numpy as np
from jaxtyping import Float

_WIDTH_EDGES = (1.3, 5.0)
"""Bounds of half the width of a ridge over the edge length, log-uniform. A narrower ridge would
fall between the vertices."""

HEIGHT_M = (0.0008, 0.007)
"""Bounds of the height of a ridge [m], log-uniform."""

STEEPEST = 0.22
"""Largest height over half width; on steeper flanks edges would not keep their lengths."""

LENGTH = (0.06, 0.4)
"""Bounds of the length of a ridge, over the extent of the cloth."""

_MOST = 16

_STACK_HEIGHT = 4.0
"""Largest height over the thickness for stacked layers. A ridge is straight between vertices, and
the layers' vertices are not above each other, so a higher ridge would push one layer through
another."""


def wrinkled(
    points: Float[np.ndarray, "vertices 3"],
    *,
    edge_m: float,
    stacked_m: float | None,
    rng: np.random.Generator,
) -> Float[np.ndarray, "vertices 3"]:
    """Add random ridges to a cloth.

    Args:
        points: vertices [m], the table at z = 0.
        edge_m: length of an edge of the mesh [m].
        stacked_m: thickness of stacked layers [m]; None for a single layer.
    """
    extent_m = float(np.ptp(points[:, :2], axis=0).max())
    main = rng.uniform(0.0, np.pi)
    for _ in range(int(rng.integers(1, _MOST + 1))):
        width_m = edge_m * float(np.exp(rng.uniform(*np.log(_WIDTH_EDGES))))
        height_m = min(float(np.exp(rng.uniform(*np.log(HEIGHT_M)))), STEEPEST * width_m)
        if stacked_m is not None:
            height_m = min(height_m, _STACK_HEIGHT * stacked_m)
        # Wrinkles of one cloth have roughly the same direction.
        angle = main + 0.5 * rng.standard_normal()
        across = np.array([np.cos(angle), np.sin(angle)])
        along = np.array([-across[1], across[0]])
        away = points[:, :2] - points[int(rng.integers(len(points))), :2]
        fading = np.exp(-np.square(away @ along / (extent_m * rng.uniform(*LENGTH))))
        slope = np.tanh(away @ across / width_m)
        drawn_m = 2.0 * height_m**2 / width_m * (slope**3 / 3.0 - slope**5 / 5.0) * fading**2
        points = points.copy()
        points[:, :2] -= drawn_m[:, None] * across
        points[:, 2] += height_m * (1.0 - slope**2) * fading
    return points
