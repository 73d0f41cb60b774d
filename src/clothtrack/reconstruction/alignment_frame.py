"""Turns an observed cloth into the canonical frame, so that what is left to learn is its shape.

The cloth lies on a table: it may be turned about the vertical and it may lie on its face. Both are
found in closed form from the canonical coordinates of the seen points.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

TURNED_OVER = np.diag([-1.0, 1.0, -1.0])
"""A half turn about the canonical y axis, from hem to neck: the cloth lies on its face."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """A rigid motion between the world and the canonical frame.

    Attributes:
        rotation: turns world directions into the canonical frame.
        world_center: the world position [m] that goes to `canonical_center`.
        canonical_center: where it goes [m].
    """

    rotation: Float[np.ndarray, "3 3"]
    world_center: Float[np.ndarray, " 3"]
    canonical_center: Float[np.ndarray, " 3"]

    def to_canonical(self, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 3"]:
        """World positions [m] in the canonical frame."""
        return (points - self.world_center) @ self.rotation.T + self.canonical_center

    def to_world(self, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 3"]:
        """Positions in the canonical frame [m], in the world."""
        return (points - self.canonical_center) @ self.rotation + self.world_center


def align(
    observed: Float[np.ndarray, "points 3"],
    canonical: Float[np.ndarray, "points 3"],
    weights: Float[np.ndarray, " points"],
) -> Alignment:
    """The turn about the vertical, on back or on face, that brings observed points home.

    Least squares over the weighted points; for each side of the cloth the angle is the argument
    of the weighted sum of products of the horizontal parts (B. Horn, 1987, doi:10.1364/
    JOSAA.4.000629, in the plane), and the side with the smaller remainder wins.

    Args:
        observed: seen points [m], world, z up.
        canonical: their canonical positions [m].
        weights: confidence of each canonical position, not negative. When all are 0 they are equal.
    """
    share = weights if weights.sum() > 0 else np.ones(len(weights))
    share = share / share.sum()
    world_center, canonical_center = share @ observed, share @ canonical
    target = canonical - canonical_center
    best = (-np.inf, np.eye(3))
    for side in (np.eye(3), TURNED_OVER):
        source = (observed - world_center) @ side.T
        products = (source * share[:, None]).T @ target
        along, across = products[0, 0] + products[1, 1], products[0, 1] - products[1, 0]
        length = float(np.hypot(along, across))
        gain = length + float(products[2, 2])
        if gain > best[0]:
            cosine, sine = (along / length, across / length) if length > 0 else (1.0, 0.0)
            turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
            best = (gain, turn @ side)
    return Alignment(best[1], world_center, canonical_center)
