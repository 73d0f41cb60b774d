"""A dry run writes what it would do, and ends."""

import json

import cv2
import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.camera import Camera
from clothtrack.planning.action_space import PickPlace, Workspace
from clothtrack.planning.robots.dry_run import STOPPED, DryRunRobot
from clothtrack.planning.robots.robot import MotionLimits, PickPlaceRobot, RgbdFrame

POSE = np.diag([1.0, -1.0, -1.0, 1.0])
POSE[2, 3] = 0.8
CAMERA = Camera("top", 160, 120, 150.0, 150.0, 79.5, 59.5, POSE)
ACTION = PickPlace(np.array([0.05, 0.0, 0.01]), np.array([-0.1, 0.1, 0.01]), 0.05)


def frame():
    color = np.full((120, 160, 3), 90, np.uint8)
    return RgbdFrame(1.0, CAMERA, np.full((120, 160), 0.8, np.float32), color)


def test_the_plan_is_on_disk_and_nothing_moved(tmp_path):
    robot = DryRunRobot(frame, tmp_path)
    assert isinstance(robot, PickPlaceRobot)
    robot.observe()
    done = robot.execute(ACTION)
    assert done.error == STOPPED
    assert done.grasped is None
    told = json.loads((tmp_path / "action_00.json").read_text())
    assert told["pick"] == ACTION.pick.tolist()
    assert len(told["waypoints"]) == 6
    assert cv2.imread(str(tmp_path / "action_00.png")).shape == (120, 160, 3)
    robot.execute(ACTION)
    assert (tmp_path / "action_01.json").exists()


def test_limits_hold_in_a_dry_run_too(tmp_path):
    robot = DryRunRobot(frame, tmp_path, limits=MotionLimits(Workspace(x_m=(0.0, 0.1))))
    assert not robot.check(ACTION).reachable
    with pytest.raises(InvalidConfigError, match=r"workspace\.x_m"):
        robot.execute(ACTION)
    assert not list(tmp_path.iterdir())
