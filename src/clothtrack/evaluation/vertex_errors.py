"""Which vertices of a label to expect wrong: where its candidates disagree, or the cloud does.

The search for the cloth's parameters tracks every action several times. All candidates fit the
cloud; they differ where it does not decide, under folds above all. Their spread tells which
vertices are wrong, the label's expected error how wrong they are on the whole, and a patch that
lies away from what was seen is at least that far off (docs/label_quality.md).
"""

import numpy as np
from jaxtyping import Float

from clothtrack.evaluation.label_quality import LabelQuality
from clothtrack.tracking.tracked_trajectory import TrackedAction

_SPREAD_SHARE = 0.8
"""Share of the expected error that is dealt out by the spread; the rest falls on all alike."""

INTERVAL_FACTOR = 1.9
"""The error of 90 % of the vertices is at most so many times what is expected of each. Fitted on
the labels of the benchmark's split `dev` (docs/label_quality.md); nothing is taken for Gaussian."""


def expected_vertex_errors(
    action: TrackedAction, label: LabelQuality
) -> Float[np.ndarray, " vertices"]:
    """Return the error to expect of each vertex of a label [m].

    Their mean is the label's where nothing that was seen contradicts the mesh, larger elsewhere.

    Args:
        action: with the spread of its candidates; without one, all vertices are alike.
        label: the same action's label, judged; NaN where nothing was seen.
    """
    expected_m = 1e-3 * label.expected_error_mm
    spread_m, vertices = action.calibration.spread_m, len(action.positions_after_final_alignment)
    mean_m = float(spread_m.mean()) if len(spread_m) else 0.0
    dealt = np.full(vertices, expected_m)
    if mean_m > 0.0:
        dealt = expected_m * (1.0 - _SPREAD_SHARE + _SPREAD_SHARE * spread_m / mean_m)
    misfit = label.evidence.misfit
    return dealt if misfit is None else np.maximum(dealt, misfit.patch_m)
