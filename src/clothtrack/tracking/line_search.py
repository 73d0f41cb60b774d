"""Find the largest stable share of a correction (paper, Sec. III-B.3).

A correction that pushes layers into each other makes the simulated cloth diverge. The search rolls
out the dynamics with the whole correction, then with smaller and smaller shares of it, and accepts
the first stable roll-out. If none is stable, the pseudo-action is dropped for this frame; this is
recorded and is not an error.

Tracking never continues from a coarse prediction. If no correction is applied, the dynamics are
rolled out again without a pseudo-action.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clothtrack.simulation.picker_action import PickerAction
from clothtrack.simulation.state import Attachment
from clothtrack.tracking.protocols import Corrected, Correction, Dynamics, Prediction, State

_DECAY = 0.7
"""Factor between one trial and the next; gamma = 0.7 in the paper."""

TRIALS = 10
"""Roll-outs before the pseudo-action is dropped; 10 in the paper."""

_EXPLOSION_SPEED = 3.0
"""A vertex faster than this [m/s] counts as an explosion. The paper does not state its threshold;
1 m/s rejects valid steps."""

_EXPLOSION_RATIO = 15.0
"""With a fast picker the threshold is this many times the picker's speed."""

_PREDICTION_RATIO = 1.5
"""The threshold is at least this many times the highest speed of the prediction, because speeds
without a pseudo-action are not an explosion."""


def explosion_threshold(picker_speed: float, predicted_speed: float) -> float:
    """Return the speed [m/s] that counts as an explosion.

    Args:
        picker_speed: speed of the fastest picker in this frame [m/s].
        predicted_speed: highest speed of a vertex without a pseudo-action [m/s].
    """
    own = _PREDICTION_RATIO * predicted_speed if np.isfinite(predicted_speed) else 0.0
    return max(_EXPLOSION_SPEED, _EXPLOSION_RATIO * picker_speed, own)


@dataclass(frozen=True)
class PseudoActionSearch:
    """Line search over roll-outs with smaller and smaller shares of the correction.

    Attributes:
        strength: 1 holds attached vertices at their targets ("held", the paper's pseudo-action);
            less than 1 pulls them there inside the solver loop ("soft"), so that contacts, stretch
            and table take precedence over the observation.
        threshold: returns the speed that counts as an explosion [m/s], given the speeds of picker
            and prediction.
    """

    strength: float
    threshold: Callable[[float, float], float] = explosion_threshold

    def __call__(
        self,
        dyn: Dynamics,
        state: State,
        action: PickerAction,
        predicted: Prediction,
        correction: Correction | None,
    ) -> Corrected:
        """Return the first stable roll-out, or the dynamics alone if there is none."""
        if correction is None:
            return Corrected(_alone(dyn, state, action, predicted))
        scale = 1.0
        threshold = self.threshold(action.speed, float(predicted.highest_speed.max()))
        for trial in range(1, TRIALS + 1):
            rolled = dyn(state, action, self._pseudo_action(correction, scale))
            if is_stable(rolled, threshold):
                return Corrected(rolled, scale, trial)
            scale *= _DECAY
        return Corrected(_alone(dyn, state, action, predicted), 0.0, TRIALS, gave_up=True)

    def _pseudo_action(self, correction: Correction, scale: float) -> Attachment:
        """Return a~_t: targets of the attached vertices for this share of the correction."""
        strength = np.where(correction.attached, self.strength, 0.0).astype(np.float32)
        targets = (correction.start + scale * correction.displacement)[None].astype(np.float32)
        return Attachment(targets, strength[None])


def _alone(dyn: Dynamics, state: State, action: PickerAction, predicted: Prediction) -> Prediction:
    """Return the roll-out without a pseudo-action."""
    return predicted if predicted.exact else dyn(state, action)


def is_stable(roll_out: Prediction, threshold: float) -> bool:
    """Return whether every vertex stayed finite and slower than the threshold [m/s]."""
    fastest = float(np.max(roll_out.highest_speed))
    finite = bool(np.isfinite(roll_out.positions).all())
    return bool(np.isfinite(fastest) and fastest <= threshold and finite)
