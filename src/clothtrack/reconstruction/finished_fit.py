"""The complete fit of one answer: placed, with ordered layers, and without self-intersections."""

from dataclasses import replace

import numpy as np

from clothtrack.reconstruction.isometric_fit import EDGES, Guide, IsometricFit
from clothtrack.reconstruction.seen_cloth import SeenCloth
from clothtrack.recordings.recording import Table
from clothtrack.simulation.untangling import Untangler, Untangling

SEEN_MOBILITY = 0.3
"""Mobility of a visible vertex in the last untangling. It is low because visible vertices were
measured, while hidden ones were guessed."""

_LAST_ROUNDS = 30
"""Maximum rounds of a final untangling that moves visible vertices as freely as hidden ones."""


def finished(
    fit: IsometricFit,
    guide: Guide,
    cloth: SeenCloth,
    *,
    table: Table | None,
    opposite: bool = False,
    device: str = "cpu",
) -> Untangling:
    """Return the complete fit of a garment to a prediction and a picture.

    The garment is fitted, its layers are put in the order that the network predicts, and crossings
    are untangled. Untangling moves visible vertices, so the cloth is attracted to the picture once
    more, with layers in their current order, and the last crossings are untangled gently.
    """
    apart = Untangler(fit.rest, device=device)
    order_m = -guide.places[:, 2] if opposite else guide.places[:, 2]
    laid = fit.lay(guide, cloth, EDGES, order_m=order_m)
    laid = fit.layered(laid, order_m, cloth.table_m)
    first = apart(laid, table=table)
    drawn = fit.polished(first.positions, cloth, guide.size_m)
    drawn = fit.layered(drawn, drawn[:, 2], cloth.table_m, keep=1.0, votes=1)
    mobility = np.where(fit.visible(drawn, cloth), SEEN_MOBILITY, 1.0)
    last = apart(drawn, mobility=mobility, table=table)
    if last.crossings_after:
        last = apart(last.positions, table=table, rounds=_LAST_ROUNDS)
    return replace(last, crossings_before=first.crossings_before)
