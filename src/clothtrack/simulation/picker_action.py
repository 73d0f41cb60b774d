"""a_t: what the pickers do between two frames."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class HeldMotion:
    """The path of held vertices during a roll-out.

    Attributes:
        waypoints: their targets [m] at times equally spaced over the roll-out, the first at its
            start; with an environments axis if the paths differ.
    """

    vertices: Int[np.ndarray, " held"]
    waypoints: Float[np.ndarray, "knots held 3"] | Float[np.ndarray, "environments knots held 3"]

    def at(self, share: float) -> Float[np.ndarray, "environments held 3"]:
        """Return the targets after a share of the roll-out (0 to 1), by linear interpolation."""
        points = np.asarray(self.waypoints, dtype=np.float64)
        if points.ndim == 3:
            points = points[None]
        place = share * (points.shape[1] - 1)
        knot = min(int(place), max(points.shape[1] - 2, 0))
        after = min(knot + 1, points.shape[1] - 1)
        blend = place - knot
        return (1.0 - blend) * points[:, knot] + blend * points[:, after]

    @property
    def longest_path_m(self) -> float:
        """Path length [m] of a vertex that moves at the speed of the fastest leg throughout."""
        points = np.asarray(self.waypoints, dtype=np.float64)
        if points.size == 0 or points.shape[-3] < 2:
            return 0.0
        legs = np.linalg.norm(np.diff(points, axis=-3), axis=-1)
        return float(legs.max()) * legs.shape[-2]


@dataclass(frozen=True, eq=False)
class PickerAction:
    """a_t: what the pickers do between two frames.

    Attributes:
        motion: the held vertices and their path; None holds none.
        duration_s: time between the frames [s].
        speed: speed of the fastest picker that holds cloth [m/s].
    """

    motion: HeldMotion | None
    duration_s: float
    speed: float = 0.0
