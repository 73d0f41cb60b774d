"""Selection of the tracked meshes that become labels."""

import logging
import math
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from clothtrack.evaluation.label_quality import LabelQuality
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

if TYPE_CHECKING:
    from clothtrack.reconstruction.data.pseudo_labels import PseudoLabel

logger = logging.getLogger(__name__)


def pseudo_labels_of(
    tracked: TrackedTrajectory, judged: Sequence[LabelQuality], rejected: Collection[int]
) -> "list[PseudoLabel]":
    """Return the first frame and the end of every action that has a quality and is not rejected."""
    from clothtrack.reconstruction.data.pseudo_labels import PseudoLabel

    chosen = [PseudoLabel(int(tracked.frames[0]), tracked.positions[0])]
    for action, quality in zip(tracked.actions, judged, strict=True):
        if quality.action in rejected:
            continue
        if math.isnan(quality.expected_error_mm):
            logger.warning(
                "%s: frame %d has no label: nothing was seen to judge it by",
                tracked.name,
                quality.frame,
            )
            continue
        chosen.append(PseudoLabel(quality.frame, action.positions_after_final_alignment))
    return chosen
