"""Which tracked meshes become labels, and with which weight."""

import logging
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
    weighted: bool,
    flat_weight: float,
) -> "list[PseudoLabel]":
    """The first frame and the end of every action; not what is rejected or nobody can judge."""
    from clothtrack.reconstruction.data.pseudo_labels import PseudoLabel

    chosen = []
    if flat_weight > 0.0:
        chosen.append(PseudoLabel(int(tracked.frames[0]), tracked.positions[0], flat_weight))
    for action, quality in zip(tracked.actions, judged, strict=True):
        if quality.action in rejected:
            continue
        weight = quality.label_quality if weighted else 1.0
        if not weight > 0.0:
            logger.warning(
                "%s: frame %d has no label: nothing was seen to judge it by",
                tracked.name,
                quality.frame,
            )
            continue
        positions = action.positions_after_final_alignment
        chosen.append(PseudoLabel(quality.frame, positions, float(weight)))
    if not chosen:
        raise InvalidResultError(
            f"{tracked.name}: no label is left ({len(rejected)} of {len(judged)} rejected in "
            "review); leave this trajectory out"
        )
    return chosen
