"""Which tracked meshes become labels."""

import logging
import math
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.label_quality import LabelQuality
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

if TYPE_CHECKING:
    from clothtrack.reconstruction.data.pseudo_labels import PseudoLabel

logger = logging.getLogger(__name__)


def pseudo_labels_of(
    tracked: TrackedTrajectory,
    judged: Sequence[LabelQuality],
    rejected: Collection[int],
    *,
    flat_start: bool,
) -> "list[PseudoLabel]":
    """Return the end of every action that is neither rejected nor impossible to judge.

    Args:
        tracked: what the tracker left.
        judged: its labels, judged.
        rejected: actions whose labels were rejected in a review, from 0.
        flat_start: take the first frame, before any action, too.

    Raises:
        InvalidResultError: no label is left.
    """
    from clothtrack.reconstruction.data.pseudo_labels import PseudoLabel

    chosen = []
    if flat_start:
        chosen.append(PseudoLabel(int(tracked.frames[0]), tracked.positions[0]))
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
        positions = action.positions_after_final_alignment
        chosen.append(PseudoLabel(quality.frame, positions))
    if not chosen:
        raise InvalidResultError(
            f"{tracked.name}: no label is left ({len(rejected)} of {len(judged)} rejected in "
            "review); leave this trajectory out"
        )
    return chosen
