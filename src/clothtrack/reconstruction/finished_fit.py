"""The whole fit of one answer: in its place, in layers, and without passages through itself."""

from dataclasses import replace

import numpy as np

from clothtrack.reconstruction.isometric_fit import EDGES, Guide, IsometricFit
from clothtrack.reconstruction.seen_cloth import SeenCloth
from clothtrack.recordings.recording import Table
from clothtrack.simulation.untangling import Untangler, Untangling

SEEN_MOBILITY = 0.3
"""Mobility of a vertex that is seen when a finished fit is taken apart: it lies where it was
measured, and what is hidden was guessed."""

_LAST_ROUNDS = 30
"""Most rounds in which what still crosses is taken apart wherever it is seen."""


def finished(
    fit: IsometricFit,
    guide: Guide,
    cloth: SeenCloth,
    *,
    table: Table | None,
    opposite: bool = False,
    device: str = "cpu",
) -> Untangling:
    """A garment where an answer and a picture want it.

    The cloth is laid, its layers are put in the order that the network gives them, and what
    crosses is taken apart. That moves what was seen, so that the cloth is drawn to the picture once
    more, layers in the order that they have by now, and the last crossings are taken apart gently.

    Args:
        fit: of the garment.
        guide: what the network says.
        cloth: what was seen.
        table: what the cloth lies on.
        opposite: lay what the network puts on top below.
        device: "cpu" or "cuda:0".
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
