"""Lays fine wrinkles into a cloth that lies flat or folded, as washed cotton has them.

A wrinkle is a ridge of a few millimeters that runs some way and fades. The whole stack rises with
it, so that layers keep their order, and cloth is drawn in from both sides by as much as the ridge
takes up, so that edges keep their lengths.
"""

import numpy as np
from jaxtyping import Float

_WIDTH_EDGES = (1.3, 5.0)
"""Half width of a ridge over the length of an edge; the logarithm is drawn evenly. A narrower one
falls between the vertices."""

HEIGHT_M = (0.0008, 0.007)
"""Height of a ridge [m]; the logarithm is drawn evenly."""

STEEPEST = 0.22
"""Largest height over half width: edges on its flanks would not keep their lengths."""

LENGTH = (0.06, 0.4)
"""How far a ridge runs, over the extent of the cloth."""

_MOST = 16

_STACK_HEIGHT = 4.0
"""Largest height over the thickness where layers lie on each other. Between vertices a ridge is
straight, and the layers' vertices are not above each other: more would push one through another."""


def wrinkled(
    points: Float[np.ndarray, "vertices 3"],
    *,
    edge_m: float,
    stacked_m: float | None,
    rng: np.random.Generator,
) -> Float[np.ndarray, "vertices 3"]:
    """Lay a few ridges into a cloth.

    Args:
        points: vertices [m], the table at z = 0.
        edge_m: length of an edge of the mesh [m].
        stacked_m: thickness of layers that lie on each other [m]; None where there is one layer.
        rng: of their number, places and shapes.
    """
    extent_m = float(np.ptp(points[:, :2], axis=0).max())
    main = rng.uniform(0.0, np.pi)
    for _ in range(int(rng.integers(1, _MOST + 1))):
        width_m = edge_m * float(np.exp(rng.uniform(*np.log(_WIDTH_EDGES))))
        height_m = min(float(np.exp(rng.uniform(*np.log(HEIGHT_M)))), STEEPEST * width_m)
        if stacked_m is not None:
            height_m = min(height_m, _STACK_HEIGHT * stacked_m)
        # Wrinkles of one cloth run alike, more or less.
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
