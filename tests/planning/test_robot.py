"""Limits name the first point that breaks them."""

import numpy as np
import pytest

from clothtrack.planning.action_space import PickPlace, Workspace
from clothtrack.planning.robots.robot import MotionLimits, waypoints

LIMITS = MotionLimits(Workspace((-0.2, 0.2), (-0.1, 0.1), (0.0, 0.3)), 0.05, clearance_m=0.01)


@pytest.mark.parametrize(
    ("point", "told"),
    [
        ([0.3, 0.0, 0.1], "x = 0.3"),
        ([0.0, -0.2, 0.1], "workspace.y_m"),
        ([0.0, 0.0, 0.31], "z = 0.31"),
        ([0.0, 0.0, 0.055], "lower than table_height_m"),
        ([0.0, np.nan, 0.1], "not finite"),
    ],
)
def test_a_refusal_names_value_and_limit(point, told):
    fine = [0.0, 0.0, 0.1]
    assert LIMITS.refusal(np.array([fine])) == ""
    assert told in LIMITS.refusal(np.array([fine, point, fine]))


def test_way_points_come_from_above_and_go_up_again():
    action = PickPlace(np.array([0.0, 0.0, 0.06]), np.array([0.1, 0.0, 0.07]), 0.05)
    points = waypoints(action, 0.12)
    np.testing.assert_allclose(points[1], action.pick)
    np.testing.assert_allclose(points[4], action.place)
    np.testing.assert_allclose(points[[0, 5], 2], [0.18, 0.19])
    # Straight up, level, straight down: cloth is not dragged over what it lies on.
    np.testing.assert_allclose(points[2, 2], points[3, 2])
    np.testing.assert_allclose(points[2, :2], action.pick[:2])
    np.testing.assert_allclose(points[3, :2], action.place[:2])
    assert points[2, 2] == pytest.approx(0.12)
