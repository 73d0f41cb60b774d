"""Aligns an observed cloth with the canonical frame, so that only its shape is left to learn.

The cloth lies on a table. It may be rotated about the vertical and may lie on its face. Both are
computed in closed form from the canonical coordinates of the observed points.
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
        rotation: rotation of world directions into the canonical frame.
        world_center: world position [m] that maps to `canonical_center`.
        canonical_center: canonical position [m] that `world_center` maps to.
    """

    rotation: Float[np.ndarray, "3 3"]
    world_center: Float[np.ndarray, " 3"]
    canonical_center: Float[np.ndarray, " 3"]

    def to_canonical(self, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 3"]:
        """Return world positions [m] in the canonical frame."""
        return (points - self.world_center) @ self.rotation.T + self.canonical_center

    def to_world(self, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 3"]:
        """Return world positions [m] of positions in the canonical frame [m]."""
        return (points - self.canonical_center) @ self.rotation + self.world_center


def align(
    observed: Float[np.ndarray, "points 3"],
    canonical: Float[np.ndarray, "points 3"],
    weights: Float[np.ndarray, " points"],
) -> Alignment:
    """Return the rotation about the vertical, on back or on face, that aligns observed points.

    Solves weighted least squares over the points. For each side of the cloth the angle is the
    argument of the weighted sum of products of the horizontal parts (B. Horn, 1987, doi:10.1364/
    JOSAA.4.000629, in the plane). The side with the smaller residual is taken.

    Args:
        observed: observed points [m], world, z up.
        canonical: canonical positions of the points [m].
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
