"""Measured points of a cloth, with the correspondences that a network predicts."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.camera import about_vertical


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Points of one picture with the canonical positions that a network predicts.

    Attributes:
        points: measured positions [m], world, z up.
        canonical: canonical positions of the points [m].
        confidence: confidence of each canonical position, 0 to 1.
    """

    points: Float[np.ndarray, "points 3"]
    canonical: Float[np.ndarray, "points 3"]
    confidence: Float[np.ndarray, " points"]

    def scaled(self, factor: float) -> "SeenPoints":
        """Return the same points in a world that is larger by a factor."""
        return SeenPoints(self.points * factor, self.canonical * factor, self.confidence)

    def turned(self, angle_rad: float) -> "SeenPoints":
        """Return the same points in a world turned about the vertical through its origin."""
        return replace(self, points=self.points @ about_vertical(angle_rad).T)
