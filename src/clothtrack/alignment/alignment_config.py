"""The objective of test-time optimisation and how it is minimised."""

from dataclasses import dataclass
from typing import Annotated, Literal

from clothtrack.files.bounds import Checked, Count, Interval, NotNegative, Positive


@dataclass(frozen=True)
class AlignmentConfig(Checked):
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
    iterations: Count = 200
    step_m: Positive = 1e-3
    chamfer_weight: NotNegative = 1.0
    rigidity_weight: NotNegative = 10.0
    two_way_weight: NotNegative = 1.0
    two_way_range_m: Annotated[tuple[float, float], Interval(least=0)] = (0.004, 0.08)
    length_weight: NotNegative = 300.0
    table_weight: NotNegative = 10.0
    vertical_weight: NotNegative = 1.0
    neighbours_every: Count = 1
    icp_outer: Count = 8
    icp_inner: Count = 12
    icp_momentum: float = 0.8
