"""The objective of test-time optimisation and how it is minimised."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from clothtrack.errors import InvalidConfigError


@dataclass(frozen=True)
class AlignmentConfig:
    """The objective and how it is minimised. Every term is a mean of squares [m^2].

    Attributes:
        solver: "adam" follows the paper; "icp" (fixed matches, Gauss-Newton, conjugate gradients)
            is several times faster and ends a few percent higher.
        iterations: steps of Adam (the paper: 200).
        step_m: step of Adam [m].
        chamfer_weight: cloud point to nearest visible vertex (the paper: 1).
        rigidity_weight: difference of the displacements along edges (the paper: 10).
        two_way_weight: trusted visible vertex to nearest cloud point; 0 is the paper.
        two_way_range_m: only vertices whose nearest cloud point is that far away count [m]: nearer
            is the cloud's spacing, farther is what the camera missed.
        length_weight: stretch of edges against the first mesh; 0 is the paper.
        table_weight: depth under the resting height (the reference implementation: 10).
        vertical_weight: factor of the vertical part of squared residuals against the cloud; below
            1 while the thickness of the layers is not known.
        neighbours_every: renew the neighbours every so many iterations.
        icp_outer: how often the icp solver renews matches and linearisation.
        icp_inner: conjugate gradient steps in between.
        icp_momentum: part of the last outer step that is added to the next.
    """

    solver: Literal["adam", "icp"] = "adam"
    iterations: int = 200
    step_m: float = 1e-3
    chamfer_weight: float = 1.0
    rigidity_weight: float = 10.0
    two_way_weight: float = 1.0
    two_way_range_m: tuple[float, float] = (0.004, 0.08)
    length_weight: float = 300.0
    table_weight: float = 10.0
    vertical_weight: float = 1.0
    neighbours_every: int = 1
    icp_outer: int = 8
    icp_inner: int = 12
    icp_momentum: float = 0.8

    def __post_init__(self) -> None:
        """Refuse values that cannot be meant.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        if self.solver not in ("adam", "icp"):
            raise InvalidConfigError(f"alignment solver is {self.solver!r}; use 'adam' or 'icp'")
        for name in ("iterations", "neighbours_every", "icp_outer", "icp_inner"):
            if getattr(self, name) < 1:
                raise InvalidConfigError(f"{name} is {getattr(self, name)}; it must be at least 1")
        for name in ("chamfer", "rigidity", "two_way", "length", "table", "vertical"):
            value = getattr(self, f"{name}_weight")
            if not (np.isfinite(value) and value >= 0):
                raise InvalidConfigError(f"{name}_weight is {value}; it must be 0 or more")
        if not self.step_m > 0:
            raise InvalidConfigError(f"step_m is {self.step_m}; it must be positive [m]")
        low, high = self.two_way_range_m
        if not 0 <= low < high < np.inf:
            raise InvalidConfigError(
                f"two_way_range_m is {self.two_way_range_m}; it must be (low, high) in metres with "
                "0 <= low < high"
            )
