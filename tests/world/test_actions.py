"""Random pick-and-places: within their ranges, on the cloth, at a bounded speed."""

import numpy as np
import pytest

from clothtrack.simulation.garments import towel, tshirt
from clothtrack.world.actions import ActionConfig, carrying_path, free_path, plan_action

CONFIG = ActionConfig()
STEP_S = 0.005


@pytest.mark.parametrize("seed", range(8))
def test_plans_keep_to_their_ranges(seed: int) -> None:
    cloth = tshirt(0.4, 0.36, 0.02)
    plan = plan_action(cloth, CONFIG, np.random.default_rng(seed))
    way = np.linalg.norm((plan.place - plan.pick)[:2])
    assert CONFIG.distance_m[0] <= way <= CONFIG.distance_m[1]
    assert CONFIG.lift_m[0] <= plan.lift_m <= CONFIG.lift_m[1]
    assert np.linalg.norm(plan.place[:2]) < CONFIG.reach_m
    assert np.array_equal(plan.pick, cloth.vertices[plan.held[0]])
    reach = np.linalg.norm(cloth.vertices[plan.held, :2] - plan.pick[:2], axis=1)
    assert reach.max() < CONFIG.grasp_radius_m


def test_grasps_take_the_upper_layer_and_sometimes_the_lower_one_too() -> None:
    cloth = tshirt(0.4, 0.36, 0.012)
    plans = [plan_action(cloth, CONFIG, np.random.default_rng(seed)) for seed in range(60)]
    side = np.sign(cloth.canonical[:, 2])
    assert all(side[plan.held[0]] >= 0 for plan in plans)
    double = [plan for plan in plans if len(plan.held) == 2]
    assert 5 < len(double) < 45
    assert all(side[plan.held[1]] < 0 for plan in double)


def test_picks_are_mostly_near_the_outline() -> None:
    cloth = towel(0.3, 0.3, 0.015)
    plans = [plan_action(cloth, CONFIG, np.random.default_rng(seed)) for seed in range(60)]
    from_middle = np.array([np.abs(plan.pick[:2]).max() for plan in plans])
    assert 0.6 < (from_middle > 0.12).mean() < 1.0


@pytest.mark.parametrize("seed", range(4))
def test_carrying_path_is_smooth_and_fits_the_pictures(seed: int) -> None:
    cloth = towel(0.3, 0.3, 0.015)
    plan = plan_action(cloth, CONFIG, np.random.default_rng(seed))
    path = carrying_path(plan, CONFIG, STEP_S)
    assert len(path) % round(1.0 / (CONFIG.frame_rate * STEP_S)) == 0
    assert np.allclose(path[-1], plan.place)
    speeds = np.linalg.norm(np.diff(path, axis=0, prepend=plan.pick[None]), axis=1) / STEP_S
    assert speeds.max() < 1.02 * CONFIG.speed
    assert speeds[[0, -1]].max() < 0.2 * CONFIG.speed
    assert path[:, 2].max() >= plan.pick[2] + 0.95 * plan.lift_m


def test_free_path_ends_at_its_end() -> None:
    start, end = np.zeros(3), np.array([0.3, 0.0, 0.4])
    path = free_path(start, end, CONFIG)
    assert np.allclose(path[-1], end)
    steps = np.linalg.norm(np.diff(path, axis=0, prepend=start[None]), axis=1)
    assert steps.max() <= CONFIG.free_speed / CONFIG.frame_rate + 1e-9
