"""How much of a correction the simulation can take (paper, Sec. III-B.3).

A correction that pushes layers into each other makes the simulated cloth diverge. The search rolls
the dynamics with the whole correction, then with ever smaller parts of it, and takes the first
roll-out that stays stable. When none does, the pseudo-action is dropped for this frame: that is a
recorded result, not an error.

A prediction may have been coarser than the dynamics. Then it is no cloth to go on from, and where
it would stand the dynamics are rolled without a pseudo-action.
"""

from dataclasses import dataclass

import numpy as np

from clothtrack.files.bounds import Checked, Count, Fraction
from clothtrack.simulation.dynamics import PickerAction
from clothtrack.simulation.state import Attachment
from clothtrack.tracking.seams import Corrected, Correction, Dyn, Prediction, State


@dataclass(frozen=True)
class LineSearchConfig(Checked):
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

    decay: Fraction = 0.7
    trials: Count = 10
    explosion_speed: float = 3.0
    explosion_ratio: float = 15.0
    prediction_ratio: float = 1.5

    def threshold(self, picker_speed: float, predicted_speed: float) -> float:
        """Speed [m/s] that counts as an explosion.

        Args:
            picker_speed: of the fastest picker in this frame [m/s].
            predicted_speed: highest speed of a vertex without a pseudo-action [m/s].
        """
        own = self.prediction_ratio * predicted_speed if np.isfinite(predicted_speed) else 0.0
        return max(self.explosion_speed, self.explosion_ratio * picker_speed, own)


class PseudoActionSearch:
    """Rolls the dynamics with the correction as pseudo-action, with ever smaller parts of it."""

    def __init__(
        self, config: LineSearchConfig, strength: float, *, prediction_stands: bool = True
    ) -> None:
        """Take the settings.

        Args:
            config: decay, number of trials and what counts as divergence.
            strength: 1 holds attached vertices at their targets, less pulls them there.
            prediction_stands: predictions are as good as the dynamics.
        """
        self._config, self._strength = config, strength
        self._prediction_stands = prediction_stands

    def __call__(
        self,
        dyn: Dyn,
        state: State,
        action: PickerAction,
        predicted: Prediction,
        correction: Correction | None,
    ) -> Corrected:
        """The first stable roll-out; that of the dynamics alone without one, or a correction.

        Args:
            dyn: the dynamics.
            state: the cloth before the frame.
            action: what the pickers do during it.
            predicted: the prediction that the correction starts from.
            correction: what the cloud wants.
        """
        if correction is None:
            return Corrected(self._alone(dyn, state, action, predicted))
        config, scale = self._config, 1.0
        threshold = config.threshold(action.speed, float(predicted.highest_speed.max()))
        for trial in range(1, config.trials + 1):
            rolled = dyn(state, action, self._pseudo_action(correction, scale))
            if is_stable(rolled, threshold):
                return Corrected(rolled, scale, trial)
            scale *= config.decay
        alone = self._alone(dyn, state, action, predicted)
        return Corrected(alone, 0.0, config.trials, gave_up=True)

    def _alone(
        self, dyn: Dyn, state: State, action: PickerAction, predicted: Prediction
    ) -> Prediction:
        """What the dynamics do without a pseudo-action."""
        return predicted if self._prediction_stands else dyn(state, action)

    def _pseudo_action(self, correction: Correction, scale: float) -> Attachment:
        """a~_t: the attached vertices are wanted where this part of the correction takes them."""
        strength = np.where(correction.attached, self._strength, 0.0).astype(np.float32)
        targets = (correction.start + scale * correction.displacement)[None].astype(np.float32)
        return Attachment(targets, strength[None])


def is_stable(roll_out: Prediction, threshold: float) -> bool:
    """Whether every vertex stayed finite and slower than the threshold [m/s]."""
    fastest = float(np.max(roll_out.highest_speed))
    return bool(np.isfinite(fastest) and fastest <= threshold and _finite(roll_out))


def _finite(roll_out: Prediction) -> bool:
    return bool(np.isfinite(roll_out.positions).all())
