"""How much of a correction the simulation can take (paper, Sec. III-B.3).

A correction that pushes layers into each other makes the simulated cloth burst. The search rolls
the dynamics with the whole correction, then with ever smaller parts of it, and takes the first
roll-out that stays calm. When none does, the pseudo-action is dropped for this frame: that is a
recorded result, not an error.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.simulation.dynamics import RollOut


@dataclass(frozen=True)
class LineSearchConfig:
    """Settings of the line search.

    Attributes:
        decay: factor between one trial and the next; gamma = 0.7 in the paper.
        trials: roll-outs before the pseudo-action is dropped; 10 in the paper.
        explosion_speed: a vertex faster than this [m/s] is an explosion, whatever the picker does.
        explosion_ratio: with a fast picker the threshold is this many times the picker's speed.
            The paper's threshold is not stated; 1 m/s was seen to give up on sound steps.
        prediction_ratio: what the dynamics do by themselves is no explosion: the threshold is at
            least this many times the prediction's highest speed.
    """

    decay: float = 0.7
    trials: int = 10
    explosion_speed: float = 3.0
    explosion_ratio: float = 15.0
    prediction_ratio: float = 1.5

    def __post_init__(self) -> None:
        """Refuse a search that cannot end.

        Raises:
            InvalidConfigError: when decay is not inside (0, 1) or trials is not positive.
        """
        if not 0.0 < self.decay < 1.0:
            raise InvalidConfigError(f"line search: decay is {self.decay}; it must be in (0, 1)")
        if self.trials < 1:
            raise InvalidConfigError(f"line search: trials is {self.trials}; at least 1 is needed")

    def threshold(self, picker_speed: float, predicted_speed: float) -> float:
        """Speed [m/s] that counts as an explosion.

        Args:
            picker_speed: of the fastest picker in this frame [m/s].
            predicted_speed: highest speed of a vertex without a pseudo-action [m/s].
        """
        own = self.prediction_ratio * predicted_speed if np.isfinite(predicted_speed) else 0.0
        return max(self.explosion_speed, self.explosion_ratio * picker_speed, own)


@dataclass(frozen=True, eq=False)
class LineSearchResult:
    """What the search settled on.

    Attributes:
        roll_out: the accepted roll-out; the plain prediction when the search gave up.
        scale: the accepted part of the correction; 0 when it gave up.
        trials: roll-outs spent.
        gave_up: no part of the correction was calm.
    """

    roll_out: RollOut
    scale: float
    trials: int
    gave_up: bool


def search_line(
    roll_with_correction: Callable[[float], RollOut],
    prediction: RollOut,
    threshold: float,
    config: LineSearchConfig,
) -> LineSearchResult:
    """Find the largest part of the correction that does not make the cloth burst.

    Args:
        roll_with_correction: rolls the dynamics with this part of the correction as pseudo-action.
        prediction: the roll-out without a pseudo-action, used when every trial bursts.
        threshold: highest speed [m/s] that is still calm.
        config: decay and number of trials.

    Returns:
        The first calm roll-out, or the prediction with `gave_up` set.
    """
    scale = 1.0
    for trial in range(1, config.trials + 1):
        roll_out = roll_with_correction(scale)
        if is_calm(roll_out, threshold):
            return LineSearchResult(roll_out, scale, trial, gave_up=False)
        scale *= config.decay
    return LineSearchResult(prediction, 0.0, config.trials, gave_up=True)


def is_calm(roll_out: RollOut, threshold: float) -> bool:
    """Whether every vertex stayed finite and slower than the threshold [m/s]."""
    fastest = float(np.max(roll_out.highest_speed))
    return bool(np.isfinite(fastest) and fastest <= threshold and _finite(roll_out))


def _finite(roll_out: RollOut) -> bool:
    return bool(np.isfinite(roll_out.positions).all())
