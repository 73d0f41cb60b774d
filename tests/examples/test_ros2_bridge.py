"""The bridge's own side, with an arm that only remembers: limits, leave, and the line protocol."""

import importlib.util
import threading
from pathlib import Path

import numpy as np
import pytest
from bridge_robot import BridgeRobot, encoded

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.geometry import Camera
from clothtrack.planning import PickPlace, Workspace
from clothtrack.planning.robots import MotionLimits, RgbdFrame

PATH = Path(__file__).parents[2] / "examples" / "ros2_bridge.py"
_spec = importlib.util.spec_from_file_location("ros2_bridge", PATH)
bridge = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(bridge)

CAMERA = Camera("top", 8, 6, 7.0, 7.0, 3.5, 2.5)
GOOD = PickPlace(np.array([0.5, 0.1, 0.01]), np.array([0.55, 0.1, 0.01]), 0.05)
WIDE = MotionLimits(Workspace((-9.0, 9.0), (-9.0, 9.0), (-9.0, 9.0)), table_height_m=-9.0)


class Arm:
    def __init__(self):
        self.moves = []

    def go(self, x, y, z):
        self.moves.append((x, y, z))

    def here(self):
        return self.moves[-1]

    def open(self):
        pass

    def close(self):
        return True

    def home(self):
        self.moves.append("home")


class Eyes:
    def __init__(self):
        self.time = 0.0

    def frame(self):
        self.time += 0.5
        return encoded(RgbdFrame(self.time, CAMERA, np.ones((6, 8), np.float32)))


@pytest.fixture
def served():
    """Both sides of the socket; the other end may move."""
    arm = Arm()
    server = bridge.serve(bridge.Bridge(arm, Eyes(), may_move=True), 0)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server.server_address[1], arm, server
    server.shutdown()
    server.server_close()
    thread.join(timeout=5)


def test_an_action_goes_there_and_comes_back_measured(served):
    port, arm, _ = served
    robot = BridgeRobot(port, limits=WIDE, may_move=True)
    done = robot.execute(GOOD)
    assert done.error == ""
    assert done.grasped is True
    np.testing.assert_allclose(done.path.positions, np.array(arm.moves))
    np.testing.assert_allclose(done.path.positions[4], GOOD.place)
    assert len(done.film) == 6
    robot.home()
    assert arm.moves[-1] == "home"
    robot.close()


def test_the_bridge_has_limits_and_leave_of_its_own(served):
    port, arm, server = served
    robot = BridgeRobot(port, limits=WIDE, may_move=True)
    low = PickPlace(GOOD.pick * [1.0, 1.0, 0.0], GOOD.place, 0.05)
    assert "z = 0.0" in robot.check(low).reason
    with pytest.raises(InvalidConfigError, match="refused before moving"):
        robot.execute(low)
    server.bridge._may_move = False
    with pytest.raises(ClothTrackError, match="--move"):
        robot.execute(GOOD)
    with pytest.raises(ClothTrackError, match="--move"):
        robot.home()
    assert not arm.moves
    robot.close()
