"""A Franka refuses before it moves: tested against an arm that only remembers."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from franka_robot import FrankaConfig, FrankaRobot, FrankyArm, subdivided

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.camera import Camera
from clothtrack.planning.action_space import PickPlace, Workspace
from clothtrack.planning.robots.robot import MotionLimits, PickPlaceRobot, RgbdFrame

POSE = np.diag([1.0, -1.0, -1.0, 1.0])
POSE[:3, 3] = 0.5, 0.0, 0.8
CAMERA = Camera("top", 32, 24, 30.0, 30.0, 15.5, 11.5, POSE)
LIMITS = MotionLimits(Workspace((0.3, 0.7), (-0.3, 0.3), (0.0, 0.5)), clearance_m=0.002, speed=0.1)
CONFIG = FrankaConfig(limits=LIMITS)
GOOD = PickPlace(np.array([0.5, 0.1, 0.01]), np.array([0.55, 0.1, 0.006]), 0.05)


class FakeArm:
    def __init__(self, fails_after=None):
        self.at = np.array([0.35, 0.0, 0.45])
        self.moves, self.speeds, self.fingers = [], [], []
        self.fails_after = fails_after

    def position(self):
        return self.at.copy()

    def move(self, position, speed):
        if self.fails_after is not None and len(self.moves) >= self.fails_after:
            raise RuntimeError("reflex: motion aborted")
        self.at = np.array(position)
        self.moves.append(self.at)
        self.speeds.append(speed)

    def open(self):
        self.fingers.append("open")

    def close(self):
        self.fingers.append("close")
        return True


def robot_of(arm, config=CONFIG, **options):
    ticks = iter(np.arange(0.0, 1000.0, 0.125))
    picture = RgbdFrame(0.0, CAMERA, np.full((24, 32), 0.8, np.float32))
    options = {"may_move": True, "clock": lambda: float(next(ticks)), **options}
    return FrankaRobot(arm, lambda: picture, config, **options)


@pytest.mark.parametrize(
    "changes",
    [
        {"pick": [0.8, 0.0, 0.01]},
        {"place": [0.5, -0.4, 0.01]},
        {"place": [0.5, 0.0, -0.01]},
        {"pick": [0.5, 0.0, 0.001]},
        {"pick": [0.5, np.nan, 0.01]},
        {"lift_m": 0.6},
    ],
)
def test_what_breaks_a_limit_moves_nothing(changes):
    arm = FakeArm()
    robot = robot_of(arm)
    action = replace(
        GOOD, **{key: one if key == "lift_m" else np.array(one) for key, one in changes.items()}
    )
    assert not robot.check(action).reachable
    with pytest.raises(InvalidConfigError, match="refused before moving"):
        robot.execute(action)
    assert not arm.moves
    assert not arm.fingers


def test_without_leave_nothing_moves():
    arm = FakeArm()
    robot = robot_of(arm, may_move=False)
    assert robot.check(GOOD).reachable
    robot.home()
    with pytest.raises(InvalidConfigError, match="may_move"):
        robot.execute(GOOD)
    assert not arm.moves
    assert not arm.fingers


def test_a_good_action_keeps_to_the_limits_and_is_measured():
    arm = FakeArm()
    robot = robot_of(arm)
    assert isinstance(robot, PickPlaceRobot)
    done = robot.execute(GOOD)
    assert done.error == ""
    assert done.grasped is True
    assert arm.fingers == ["open", "close", "open"]
    assert set(arm.speeds) == {0.1}
    points = np.array(arm.moves)
    assert LIMITS.refusal(points) == ""
    assert points[:, 2].min() >= LIMITS.clearance_m
    held = done.path.positions[done.path.closed]
    np.testing.assert_allclose(held[0, :2], GOOD.pick[:2])
    assert held[0, 2] == pytest.approx(GOOD.pick[2] - CONFIG.press_m)
    np.testing.assert_allclose(held[-1], GOOD.place)
    assert np.linalg.norm(np.diff(held, axis=0), axis=1).max() <= CONFIG.leg_m + 1e-9
    assert (np.diff(done.path.time_s) > 0).all()
    assert len(done.film) > 4
    robot.home()
    np.testing.assert_allclose(arm.at, CONFIG.home_m)


def test_the_base_frame_is_where_the_calibration_says():
    turn = np.eye(4)
    turn[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    turn[:3, 3] = 0.1, 0.2, 0.3
    arm = FakeArm()
    robot = robot_of(arm, FrankaConfig(limits=LIMITS, base_from_world=turn))
    path = robot.execute(GOOD).path
    np.testing.assert_allclose(path.positions[path.closed][-1], GOOD.place, atol=1e-12)
    over = (turn[:3, :3] @ GOOD.place) + turn[:3, 3]
    assert np.linalg.norm(np.array(arm.moves) - over, axis=1).min() < 1e-12


def test_a_fault_is_told_and_the_path_so_far_is_kept():
    arm = FakeArm(fails_after=4)
    done = robot_of(arm).execute(GOOD)
    assert "motion aborted" in done.error
    assert len(arm.moves) == 4
    assert len(done.path.time_s) >= 1


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"limits": replace(LIMITS, speed=2.0)}, "limits.speed"),
        ({"limits": replace(LIMITS, speed=0.0)}, "limits.speed"),
        ({"home_m": (0.0, 0.0, 0.3)}, "home_m"),
        ({"base_from_world": 2.0 * np.eye(4)}, "base_from_world"),
        ({"leg_m": 0.0}, "leg_m"),
    ],
)
def test_an_unsafe_cell_is_refused(changes, told):
    with pytest.raises(InvalidConfigError, match=told):
        FrankaConfig(**{"limits": LIMITS, **changes})


def test_a_driver_that_is_missing_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "franky", None)
    with pytest.raises(InvalidConfigError, match="pip install franky-control"):
        FrankyArm("10.0.0.2")


def test_a_way_is_cut_without_leaving_it():
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.0, 0.05]])
    cut = subdivided(points, 0.03)
    assert np.linalg.norm(np.diff(cut, axis=0), axis=1).max() <= 0.03
    for point in points:
        assert np.linalg.norm(cut - point, axis=1).min() < 1e-12
