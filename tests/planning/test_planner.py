"""The planner finds what dynamics of a few lines say is best."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import towel
from clothtrack.planning.action_space import SeenCloth
from clothtrack.planning.coarse_cloth import CoarseConfig
from clothtrack.planning.planner import Hypothesis, Planner, PlannerConfig
from clothtrack.planning.planning_dynamics import PlannedCloth, SimulatorDynamics

FLAT = towel(0.2, 0.2, 0.02)
LYING = FLAT.vertices + [0.0, 0.0, 0.0015]
SEEN = SeenCloth(LYING.copy(), None)
BELIEF = Hypothesis(FLAT, LYING, "towel")


class GrowTowards:
    """The cloth grows the more, the nearer the place is to a goal."""

    coarse = CoarseConfig()

    def __init__(self, goal, strength=1.0):
        self.goal = np.array(goal)
        self.strength = strength

    def predict(self, cloth, actions):
        assert isinstance(cloth, PlannedCloth)
        scales = [
            1.0 if one is None
            else 1.0 + self.strength * np.exp(-40.0 * np.sum((one.place[:2] - self.goal) ** 2))
            for one in actions
        ]  # fmt: skip
        return np.stack([cloth.positions * [scale, scale, 1.0] for scale in scales])


def plain(**settings):
    """A planner that believes what the dynamics promise."""
    return PlannerConfig(strip_m=0.0, **settings)


def decide(dynamics, config=None):
    return Planner(dynamics, config or plain()).decide(BELIEF, SEEN, np.random.default_rng(0))


def test_the_best_candidate_wins_and_its_gain_is_its_own():
    decision = decide(GrowTowards([0.2, 0.0]))
    assert len(decision.candidates) == 100
    gaps = [np.linalg.norm(one.place[:2] - [0.2, 0.0]) for one in decision.candidates]
    assert decision.action is decision.candidates[int(np.argmin(gaps))]
    assert decision.gain_m2 == decision.gains_m2.max()
    scale = 1.0 + np.exp(-40.0 * min(gaps) ** 2)
    assert decision.gain_m2 == pytest.approx(0.04 * (scale**2 - 1.0), rel=1e-3)


def test_both_orders_of_the_layers_count_alike():
    """Where the other order is as likely, the gain of the best is the mean of both."""
    dynamics = GrowTowards([0.2, 0.0])
    narrow = replace(BELIEF, positions=LYING * [0.5, 1.0, 1.0])
    planner = Planner(dynamics, plain())
    either = replace(BELIEF, opposite=narrow.positions)
    decision = planner.decide(either, SEEN, np.random.default_rng(0))
    one, other = (planner.gains(each, SEEN, decision.candidates) for each in (BELIEF, narrow))
    np.testing.assert_allclose(other, 0.5 * one, rtol=1e-6)
    both, alone = np.split(decision.gains_m2 / one, [30])
    np.testing.assert_allclose(both, 0.75, rtol=1e-6)
    np.testing.assert_allclose(alone, 1.0, rtol=1e-6)
    assert len(alone) > 0
    assert one[:30].min() >= one[30:].max()


def test_a_strip_is_no_gain():
    """Of what gains and what does not, the first is taken, however far off the second ends."""
    one = GrowTowards([0.1, 0.1])
    one.predict = lambda cloth, actions: np.stack(
        [cloth.positions * [1.0 + 0.1 * (k == 1) - 0.1 * (k > 1), 1.0, 1.0]
         for k in range(len(actions))]
    )  # fmt: skip
    decision = decide(one, PlannerConfig(strip_m=10.0))
    assert decision.gain_m2 > 0.0
    assert (decision.gains_m2 > 0.0).sum() == 1
    with pytest.raises(InvalidConfigError, match="strip_m is -1"):
        PlannerConfig(strip_m=-1.0)


def test_a_cloth_that_bursts_is_never_chosen():
    class Burst(GrowTowards):
        def predict(self, cloth, actions):
            ends = super().predict(cloth, actions)
            far = [one is not None and one.place[0] > 0.0 for one in actions]
            ends[far] = np.nan
            return ends

    decision = decide(Burst([0.2, 0.0]))
    assert decision.action.place[0] <= 0.0
    assert all(one.place[0] <= 0.0 for one in decision.candidates)


def test_the_simulator_unfolds_a_corner():
    """A corner lies folded on the towel: the best action carries it outwards."""
    folded = LYING.copy()
    over = folded[:, 0] + folded[:, 1] > 0.1
    gap = (folded[over, 0] + folded[over, 1] - 0.1)[:, None]
    folded[over, :2] -= gap
    folded[over, 2] += 0.004
    lifted = folded[over]
    seen = SeenCloth(np.concatenate([lifted, folded[~over]]), None)
    planner = Planner(SimulatorDynamics(), PlannerConfig(candidates=60))
    decision = planner.decide(Hypothesis(FLAT, folded, "towel"), seen, np.random.default_rng(0))
    assert decision.gain_m2 > 0.002
    way = (decision.action.place - decision.action.pick)[:2]
    assert way @ np.ones(2) > 0.04
    assert decision.action.pick[:2].sum() > 0.0
