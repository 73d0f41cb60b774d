"""Measured points of a cloth, and what a network calls them."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.camera import about_vertical


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Points of one picture with their canonical positions, as a network names them.

    Attributes:
        points: measured places [m], world, z up.
        canonical: their canonical positions [m].
        confidence: 0 to 1.
    """

    points: Float[np.ndarray, "points 3"]
    canonical: Float[np.ndarray, "points 3"]
    confidence: Float[np.ndarray, " points"]

    def scaled(self, factor: float) -> "SeenPoints":
        """The same in a world that is larger by a factor."""
        return SeenPoints(self.points * factor, self.canonical * factor, self.confidence)

    def turned(self, angle_rad: float) -> "SeenPoints":
        """The same in a world that is turned about the vertical through its origin."""
        return replace(self, points=self.points @ about_vertical(angle_rad).T)
