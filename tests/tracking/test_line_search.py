"""The line search takes the largest stable part of a correction, or says that there is none."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.simulation.dynamics import RollOut
from clothtrack.simulation.picker_action import PickerAction
from clothtrack.simulation.state import ClothState, ContactMemory
from clothtrack.tracking.line_search import (
    PseudoActionSearch,
    explosion_threshold,
    is_stable,
)
from clothtrack.tracking.protocols import Correction


def roll_out(speed: float, position: float = 0.0) -> RollOut:
    points = np.full((1, 2, 3), position, np.float32)
    slots, counts = np.zeros((1, 2, 1), np.int32), np.zeros((1, 2), np.int32)
    memory = ContactMemory(slots, slots.astype(np.float32), counts, counts)
    state = ClothState(points, np.zeros_like(points), memory)
    return RollOut(state, points, np.array([speed]), points)


class Dynamics:
    """Dynamics of one function."""

    def __init__(self, dyn):
        self.dyn = dyn

    def __call__(self, state, action, pseudo_action=None):
        return self.dyn(state, action, pseudo_action)

    def predict(self, state, action):
        return self.dyn(state, action, None)


STILL = PickerAction(None, 0.1)
STATE = roll_out(0.0).state
CORRECTION = Correction(
    np.zeros((2, 3)), np.array([[1.0, 0, 0], [0, 1.0, 0]]), np.array([True, False]), (1.0, 0.5)
)
SEARCH = PseudoActionSearch(0.5, lambda *_: 2.0)


@pytest.mark.parametrize(("limit", "trials"), [(1.0, 1), (0.7, 2), (0.69, 3), (0.05, 10)])
def test_takes_the_largest_power_of_the_decay_that_is_stable(limit: float, trials: int) -> None:
    tried = []

    def dyn(state, action, pseudo_action):
        scale = float(pseudo_action.targets[0, 0, 0])
        tried.append(scale)
        np.testing.assert_allclose(pseudo_action.targets[0], scale * CORRECTION.displacement)
        np.testing.assert_array_equal(pseudo_action.strength[0], [0.5, 0.0])
        return roll_out(1.0 if scale <= limit else 9.0)

    result = SEARCH(Dynamics(dyn), STATE, STILL, roll_out(0.0), CORRECTION)
    assert result.trials == trials == len(tried)
    assert result.scale == pytest.approx(0.7 ** (trials - 1))
    assert not result.gave_up


def test_gives_up_after_ten_trials_and_keeps_the_prediction() -> None:
    prediction = roll_out(0.1)
    result = SEARCH(Dynamics(lambda *_: roll_out(np.inf)), STATE, STILL, prediction, CORRECTION)
    assert result.gave_up
    assert result.prediction is prediction
    assert (result.trials, result.scale) == (10, 0.0)


def test_without_a_correction_the_prediction_stands() -> None:
    prediction = roll_out(9.0)
    result = SEARCH(Dynamics(lambda *_: roll_out(0.0)), STATE, STILL, prediction, None)
    assert result.state is prediction.state
    assert (result.trials, result.gave_up) == (0, False)


@pytest.mark.parametrize("correction", [None, CORRECTION])
def test_where_a_coarse_prediction_would_stand_the_dynamics_are_rolled_alone(correction) -> None:
    alone, coarse = roll_out(0.2), replace(roll_out(0.1), exact=False)

    def dyn(state, action, pseudo_action=None):
        return alone if pseudo_action is None else roll_out(9.0)

    result = SEARCH(Dynamics(dyn), STATE, STILL, coarse, correction)
    assert result.prediction is alone
    assert result.gave_up == (correction is not None)


def test_non_finite_is_never_stable() -> None:
    assert not is_stable(roll_out(np.nan), 2.0)
    assert not is_stable(roll_out(0.0, np.nan), 2.0)
    assert is_stable(roll_out(2.0), 2.0)


def test_threshold_grows_with_the_picker_and_with_what_the_cloth_does_by_itself() -> None:
    assert explosion_threshold(0.1, 0.5) == 3.0
    assert explosion_threshold(1.0, 0.5) == 15.0
    assert explosion_threshold(0.1, 4.0) == 6.0
    assert explosion_threshold(0.1, np.inf) == 3.0
