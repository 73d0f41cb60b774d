"""A tracker that takes not the best calibrated parameters, but those of a given rank.

The paper asks how much TTO2 makes up for a bad calibration: it tracks with the best parameters of
the grid, with those at 50 % and with those at 90 % of the ranking.
"""

from dataclasses import replace

import numpy as np

from clothtrack.recordings.recording import PickAndPlace
from clothtrack.simulation.state import ClothState
from clothtrack.tracking.tracked_trajectory import Calibration
from clothtrack.tracking.tracker import ActionContext, Tracker


class RankedTracker(Tracker):
    """A tracker with one change: which candidate of the calibration is taken."""

    _rank = 0.0

    def at_rank(self, rank: float) -> "RankedTracker":
        """This tracker, with the candidate that this share of the others outscores."""
        self._rank = rank
        return self

    def _calibrated(
        self, state: ClothState, action: PickAndPlace, parameters: dict[str, float]
    ) -> tuple[ActionContext, Calibration]:
        context, calibration = super()._calibrated(state, action, parameters)
        if calibration.best < 0:
            return context, calibration
        chosen = ranked(calibration, self._rank)
        values = dict(zip(calibration.names, calibration.candidates[chosen].tolist(), strict=True))
        taken = {**context.parameters, **values}
        return replace(context, parameters=taken), replace(calibration, best=chosen)


def ranked(calibration: Calibration, rank: float) -> int:
    """Index of the candidate that a share `rank` of the finite others outscores; 0 is the best."""
    order = np.argsort(calibration.scores, kind="stable")
    count = int(np.isfinite(calibration.scores).sum())
    return int(order[min(count - 1, round(rank * (count - 1)))])
