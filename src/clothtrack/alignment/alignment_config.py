"""The objective of test-time optimisation and how it is minimised."""

from dataclasses import dataclass
from typing import Literal

from clothtrack.files.bounds import Checked, Count, NotNegative, Share

ADAM_STEP_M = 1e-3
"""Step of Adam [m]: about as far as a vertex moves in one iteration, at most."""

TWO_WAY_RANGE_M = (0.004, 0.08)
"""Only vertices whose nearest cloud point is that far away look for it [m]: nearer is the cloud's
spacing, farther is what the camera missed."""

TABLE_WEIGHT = 10.0
"""Weight of the depth under the resting height, as in the reference implementation."""


@dataclass(frozen=True)
class AlignmentConfig(Checked):
    """The objective and how it is minimised. Every term is a mean of squares [m^2].

    Attributes:
        solver: "adam" follows the paper; "icp" (fixed matches, Gauss-Newton, conjugate gradients)
            is five to ten times faster and ends as low.
        iterations: steps of Adam (the paper: 200), or how often icp renews its matches at most.
        chamfer_weight: cloud point to nearest visible vertex (the paper: 1).
        rigidity_weight: difference of the displacements along edges (the paper: 10).
        two_way_weight: trusted visible vertex to nearest cloud point, within `TWO_WAY_RANGE_M`; 0
            is the paper.
        marks_weight: vertex to where followed points of the pictures want it, each of them as much
            as so many cloud points; 0 is the paper, which throws the colour away.
        length_weight: stretch of edges against the first mesh; 0 is the paper.
        icp_inner: conjugate gradient steps in each of its iterations.
        icp_momentum: part of its last step that is added to the next.
        icp_damping: how much it resists the turn of an edge in one step, over how much an edge
            resists stretch. Without it turns cost nothing: vertices run after their nearest points,
            find others there, and run back. It changes the way, not the minimum.
        icp_tolerance: it ends when two iterations together lower the objective by a smaller share;
            0 does all iterations.
    """

    solver: Literal["adam", "icp"] = "adam"
    iterations: Count = 200
    chamfer_weight: NotNegative = 1.0
    rigidity_weight: NotNegative = 10.0
    two_way_weight: NotNegative = 1.0
    length_weight: NotNegative = 300.0
    marks_weight: NotNegative = 300.0
    icp_inner: Count = 12
    icp_momentum: float = 0.8
    icp_damping: NotNegative = 0.2
    icp_tolerance: Share = 0.0
