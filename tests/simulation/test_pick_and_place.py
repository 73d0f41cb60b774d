"""Random pick-and-places: within their ranges, on the cloth, at a bounded speed."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel, tshirt
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.pick_and_place import (
    ActionConfig,
    carrying_path,
    folded_vertices,
    plan_action,
)

CONFIG = ActionConfig()
STEP_S = 0.005


@pytest.mark.parametrize("seed", range(3))
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


def folded_over(cloth: ClothMesh) -> ClothMesh:
    """The right third of a flat cloth, folded over to the left, a layer higher."""
    vertices = cloth.vertices.copy()
    over = vertices[:, 0] > 0.05
    vertices[over, 0] = 0.1 - vertices[over, 0]
    vertices[over, 2] += 0.004
    return cloth.with_vertices(vertices)


def test_folded_vertices_are_those_with_other_cloth_over_or_under_them() -> None:
    flat = towel(0.3, 0.3, 0.015)
    assert not folded_vertices(flat, 0.01).any()
    cloth = folded_over(flat)
    found = folded_vertices(cloth, 0.01)
    x = cloth.vertices[:, 0]
    assert found[(x > -0.03) & (x < 0.01)].all()
    assert not found[x < -0.07].any()


@pytest.mark.parametrize("seed", range(3))
def test_picks_of_a_fold_take_all_its_layers_inwards(seed: int) -> None:
    cloth = folded_over(towel(0.3, 0.3, 0.015))
    config = replace(CONFIG, picks="folded", both_layers=0.0)
    plan = plan_action(cloth, config, np.random.default_rng(seed))
    assert plan.folded
    assert len(plan.held) == 2
    middle = cloth.vertices[:, :2].mean(axis=0)
    way = plan.place[:2] - plan.pick[:2]
    inward = middle - plan.pick[:2]
    assert way @ inward > 0.7 * np.linalg.norm(way) * np.linalg.norm(inward)
