"""Pick-and-places keep their limits, and are tried more often where cloth has an edge."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.planning.action_space import (
    PICTURE_MARGIN,
    RELEASE_HEIGHT_M,
    ActionSpace,
    PickPlace,
    SeenCloth,
    Workspace,
    edge_measure,
    in_picture,
    sample_actions,
)

POSE = np.diag([1.0, -1.0, -1.0, 1.0])
POSE[2, 3] = 0.8
CAMERA = Camera("top", 320, 240, 300.0, 300.0, 159.5, 119.5, POSE)


def sheet(width=0.2, length=0.2, step=0.004, height=0.002):
    x, y = np.meshgrid(np.arange(0, width, step), np.arange(0, length, step))
    cloud = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])
    return cloud - [cloud[:, 0].mean(), cloud[:, 1].mean(), 0.0]


SEEN = SeenCloth(sheet(), CAMERA)


def test_the_edge_measure_tells_middle_edge_and_corner():
    """The middle of a half disc is 4 / (3 pi) of its radius away, a quarter's 1.41 times that."""
    cloud = sheet(step=0.002)
    found = edge_measure(cloud)
    middle = np.argmin(np.linalg.norm(cloud[:, :2], axis=1))
    edge = np.argmin(np.linalg.norm(cloud[:, :2] - [cloud[:, 0].max(), 0.0], axis=1))
    corner = np.argmax(cloud[:, 0] + cloud[:, 1])
    straight = 4.0 / (3.0 * np.pi)
    assert found[middle] < 0.02
    assert found[edge] == pytest.approx(straight, rel=0.12)
    assert found[corner] == pytest.approx(np.sqrt(2.0) * straight, rel=0.12)


def test_every_action_keeps_all_limits():
    space = ActionSpace(workspace=Workspace(x_m=(-0.15, 0.15)))
    actions = sample_actions(SEEN, 300, space, np.random.default_rng(0))
    assert len(actions) == 300
    pick = np.array([one.pick for one in actions])
    put = np.array([one.place for one in actions])
    way = np.linalg.norm((put - pick)[:, :2], axis=1)
    lift = np.array([one.lift_m for one in actions])
    assert way.min() >= space.distance_m[0]
    assert way.max() <= space.distance_m[1]
    assert lift.min() >= space.lift_m[0]
    assert lift.max() <= space.lift_m[1]
    for points in (pick, put):
        assert space.workspace.holds(points).all()
        assert in_picture(points, CAMERA, PICTURE_MARGIN).all()
    gap = np.linalg.norm(put[:, None, :2] - SEEN.cloud[None, :, :2], axis=2).min(axis=1)
    np.testing.assert_allclose(put[gap > 0.012, 2], RELEASE_HEIGHT_M)
    np.testing.assert_allclose(put[gap < 0.011, 2], 0.002 + RELEASE_HEIGHT_M)
    on = np.linalg.norm(pick[:, None] - SEEN.cloud[None], axis=2).min(axis=1)
    assert on.max() == 0.0


def test_edges_are_picked_more_often_and_equal_seeds_are_equal():
    near = ActionSpace(edges=1.0)
    border = edge_measure(SEEN.cloud) > 0.3

    def share(space):
        chosen = sample_actions(SEEN, 400, space, np.random.default_rng(3))
        picks = [np.argmin(np.linalg.norm(SEEN.cloud - one.pick, axis=1)) for one in chosen]
        return border[picks].mean()

    assert share(near) > 2.0 * share(replace(near, edges=0.0))
    twice = [sample_actions(SEEN, 5, near, np.random.default_rng(7)) for _ in range(2)]
    for one, other in zip(*twice, strict=True):
        np.testing.assert_array_equal(one.place, other.place)


def test_no_pick_is_below_the_table_however_noisy_the_cloud_is(rng):
    noisy = SEEN.cloud.copy()
    noisy[:, 2] += rng.normal(scale=0.004, size=len(noisy))
    seen = replace(SEEN, cloud=noisy)
    assert noisy[:, 2].min() < seen.table_height_m
    tried = sample_actions(seen, 200, ActionSpace(), rng)
    assert min(one.pick[2] for one in tried) >= seen.table_height_m


def test_a_path_starts_at_the_pick_rises_and_ends_at_the_place():
    action = PickPlace(np.array([0.1, 0.0, 0.01]), np.array([-0.1, 0.1, 0.02]), 0.07)
    path = action.path(0.3, 0.02)
    np.testing.assert_allclose(path[-1], action.place, atol=1e-9)
    speeds = np.linalg.norm(np.diff(np.vstack([action.pick, path]), axis=0), axis=1) / 0.02
    assert speeds.max() <= 0.3 * 1.02
    assert path[:, 2].max() == pytest.approx(0.085, abs=0.002)
