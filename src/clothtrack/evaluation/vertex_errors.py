"""Expected error per vertex, from the disagreement of the candidates and from the cloud.

The search for the cloth's parameters tracks every action several times. All candidates fit the
cloud; they differ where the cloud does not constrain them, above all under folds. Their spread
shows which vertices are wrong, and the label's expected error how wrong they are on average. A
patch at some distance from the observation has at least that error (docs/label_quality.md).
"""

import numpy as np
from jaxtyping import Float

from clothtrack.evaluation.label_quality import LabelQuality
from clothtrack.tracking.tracked_trajectory import TrackedAction

_SPREAD_SHARE = 0.8
"""Share of the expected error that is distributed by the spread; the rest is uniform."""

INTERVAL_FACTOR = 1.9
"""90 % of the vertices have an error of at most this factor times their expected error. Fitted on
the labels of the benchmark's split `dev` (docs/label_quality.md), without a Gaussian assumption."""


def expected_vertex_errors(
    action: TrackedAction, label: LabelQuality
) -> Float[np.ndarray, " vertices"]:
    """Return the expected error of each vertex of a label [m].

    Their mean is the label's expected error, or more if the observation contradicts the mesh.
    """
    expected_m = 1e-3 * label.expected_error_mm
    spread_m, vertices = action.calibration.spread_m, len(action.positions_after_final_alignment)
    mean_m = float(spread_m.mean()) if len(spread_m) else 0.0
    dealt = np.full(vertices, expected_m)
    if mean_m > 0.0:
        dealt = expected_m * (1.0 - _SPREAD_SHARE + _SPREAD_SHARE * spread_m / mean_m)
    misfit = label.evidence.misfit
    return dealt if misfit is None else np.maximum(dealt, misfit.patch_m)
