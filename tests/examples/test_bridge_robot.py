"""The bridge: one line of JSON asks, one answers; limits and leave to move are checked here."""

import json
import socket
import threading
from dataclasses import replace

import numpy as np
import pytest
from bridge_robot import BridgeRobot, encoded

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.geometry import Camera
from clothtrack.planning import PickPlace, Workspace
from clothtrack.planning.robots import MotionLimits, PickPlaceRobot, RgbdFrame

CAMERA = Camera("top", 8, 6, 7.0, 7.0, 3.5, 2.5)
FRAME = RgbdFrame(
    2.5, CAMERA, np.arange(48, dtype=np.float32).reshape(6, 8) / 50.0,
    np.arange(144, dtype=np.uint8).reshape(6, 8, 3),
)  # fmt: skip
ACTION = PickPlace(np.array([0.05, 0.0, 0.01]), np.array([-0.1, 0.1, 0.01]), 0.05)
LIMITS = MotionLimits(Workspace())


@pytest.fixture
def bridge():
    """The other side: remembers what it was asked, answers what it was told to."""
    server = socket.create_server(("127.0.0.1", 0))
    asked, answers = [], {}

    def serve():
        connection, _ = server.accept()
        with connection, connection.makefile("rb") as lines:
            for line in lines:
                request = json.loads(line)
                asked.append(request)
                answer = answers.get(request["method"], {})
                data = answer if isinstance(answer, bytes) else json.dumps(answer).encode() + b"\n"
                connection.sendall(data)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield server.getsockname()[1], asked, answers
    thread.join(timeout=5)
    server.close()


def test_pictures_and_paths_come_across_unchanged(bridge):
    port, asked, answers = bridge
    answers["observe"] = encoded(FRAME)
    answers["check"] = {"reachable": True}
    answers["execute"] = {
        "time_s": [0.0, 1.0], "positions": [[0, 0, 0], [0, 0, 1]], "closed": [True, False],
        "grasped": True, "film": [encoded(FRAME)],
    }  # fmt: skip
    robot = BridgeRobot(port, limits=LIMITS, may_move=True)
    assert isinstance(robot, PickPlaceRobot)
    seen = robot.observe()
    np.testing.assert_array_equal(seen.depth_m, FRAME.depth_m)
    np.testing.assert_array_equal(seen.color, FRAME.color)
    assert (seen.time_s, seen.camera.fx) == (2.5, 7.0)
    done = robot.execute(ACTION)
    assert done.grasped
    assert done.path.closed.tolist() == [True, False]
    assert len(done.film) == 1
    assert asked[-1]["action"] == ACTION.as_dict()
    robot.home()
    assert [one["method"] for one in asked] == ["observe", "check", "execute", "home"]
    robot.close()


def test_limits_and_leave_are_checked_on_this_side(bridge):
    port, asked, answers = bridge
    answers["check"] = {"reachable": True}
    robot = BridgeRobot(port, limits=LIMITS)
    far = replace(ACTION, place=np.array([2.0, 0.0, 0.01]))
    with pytest.raises(InvalidConfigError, match="refused before moving"):
        robot.execute(far)
    assert not asked
    with pytest.raises(InvalidConfigError, match="may_move"):
        robot.execute(ACTION)
    robot.home()
    assert [one["method"] for one in asked] == ["check"]
    robot.close()


@pytest.mark.parametrize("answer", [b"no json\n", b"[1]\n", b'{"failed": "no depth"}\n', b"{}\n"])
def test_an_answer_without_sense_is_an_error(bridge, answer):
    port, _, answers = bridge
    answers["observe"] = answer
    robot = BridgeRobot(port)
    with pytest.raises(ClothTrackError):
        robot.observe()
    robot.close()


def test_nobody_listens():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(InvalidConfigError, match="ros2_bridge"):
        BridgeRobot(port)
