"""A robot in another process: JSON lines over a local socket, as `ros2_bridge.py` answers.

ROS brings its own Python; it stays on its side. One request is one line, one answer is one line.
"""

import base64
import json
import socket
from typing import Any

import numpy as np

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.geometry import Camera
from clothtrack.planning import PickPlace
from clothtrack.planning.robots import (
    Execution,
    MotionLimits,
    Reachability,
    RgbdFrame,
    waypoints,
)
from clothtrack.recordings import PickerPath

LONGEST_LINE = 64 << 20
"""Most bytes of an answer: a line that never ends must not take all memory."""

METHODS = ("observe", "check", "execute", "home")


class BridgeRobot:
    """`PickPlaceRobot` at the other end of a socket on this machine.

    The limits are checked here too, before anything is sent.
    """

    def __init__(
        self,
        port: int,
        *,
        limits: MotionLimits | None = None,
        may_move: bool = False,
        timeout_s: float = 120.0,
    ) -> None:
        """Connect to 127.0.0.1.

        Args:
            port: that the bridge listens on.
            limits: checked before anything is sent.
            may_move: nothing that moves is asked for unless this is set.
            timeout_s: longest wait for an answer [s].

        Raises:
            InvalidConfigError: nobody listens there.
        """
        self._limits, self._may_move = limits or MotionLimits(), may_move
        try:
            self._socket = socket.create_connection(("127.0.0.1", port), timeout=timeout_s)
        except OSError as error:
            raise InvalidConfigError(
                f"no bridge listens on port {port} of this machine ({error}); start "
                "examples/ros2_bridge.py in your ROS environment first"
            ) from error
        self._lines = self._socket.makefile("rb")

    def close(self) -> None:
        """End the connection."""
        self._lines.close()
        self._socket.close()

    def observe(self) -> RgbdFrame:
        """A picture with the arm out of view."""
        return _frame(self._ask("observe"))

    def check(self, action: PickPlace) -> Reachability:
        """Our limits first, then the other side's."""
        refusal = self._limits.refusal(waypoints(action))
        if refusal:
            return Reachability(False, refusal)
        answer = self._ask("check", action=action.as_dict())
        return Reachability(bool(answer["reachable"]), str(answer.get("reason", "")))

    def execute(self, action: PickPlace) -> Execution:
        """Carry the action out over there.

        Raises:
            InvalidConfigError: it is outside a limit, or nothing may move.
        """
        found = self.check(action)
        if not found.reachable:
            raise InvalidConfigError(f"refused before moving: {found.reason}")
        self._require_motion()
        answer = self._ask("execute", action=action.as_dict())
        path = PickerPath(
            np.asarray(answer["time_s"], np.float64),
            np.asarray(answer["positions"], np.float64).reshape(-1, 3),
            np.asarray(answer["closed"], bool),
        )
        film = tuple(_frame(one) for one in answer.get("film", ()))
        return Execution(path, film, answer.get("grasped"), str(answer.get("error", "")))

    def home(self) -> None:
        """Send the arm home; without leave to move, stay."""
        if self._may_move:
            self._ask("home")

    def _require_motion(self) -> None:
        if not self._may_move:
            raise InvalidConfigError(
                "nothing moves: the robot was made without may_move=True (--move on a command line)"
            )

    def _ask(self, method: str, **more: Any) -> dict[str, Any]:
        """One request and its answer.

        Raises:
            ClothTrackError: the bridge fails, or speaks something else.
        """
        line = json.dumps({"method": method, **more}) + "\n"
        try:
            self._socket.sendall(line.encode())
            answered = self._lines.readline(LONGEST_LINE)
        except OSError as error:
            raise ClothTrackError(f"the bridge does not answer {method} ({error})") from error
        if not answered.endswith(b"\n"):
            raise ClothTrackError(
                f"the bridge ended the connection, or its answer to {method} is longer than "
                f"{LONGEST_LINE >> 20} MiB"
            )
        try:
            answer = json.loads(answered)
        except ValueError as error:
            raise ClothTrackError(f"the bridge's answer to {method} is not JSON") from error
        if not isinstance(answer, dict) or "failed" in answer:
            told = answer.get("failed") if isinstance(answer, dict) else "no object"
            raise ClothTrackError(f"the bridge cannot {method}: {told}")
        return answer


def encoded(frame: RgbdFrame) -> dict[str, Any]:
    """A picture as a line of JSON holds it: arrays as base64 of their bytes."""
    camera = frame.camera
    return {
        "time_s": frame.time_s,
        "camera": {
            **{name: getattr(camera, name)
               for name in ("name", "width", "height", "fx", "fy", "cx", "cy")},
            "world_from_camera": camera.world_from_camera.tolist(),
        },
        "depth_m": base64.b64encode(frame.depth_m.astype("<f4").tobytes()).decode(),
        "color": None if frame.color is None
        else base64.b64encode(np.ascontiguousarray(frame.color).tobytes()).decode(),
    }  # fmt: skip


def _frame(told: dict[str, Any]) -> RgbdFrame:
    """The picture that `encoded` wrote.

    Raises:
        ClothTrackError: something of it is missing or of another size.
    """
    try:
        pose = np.asarray(told["camera"]["world_from_camera"], np.float64)
        camera = Camera(**{**told["camera"], "world_from_camera": pose})
        shape = camera.height, camera.width
        depth = np.frombuffer(base64.b64decode(told["depth_m"]), "<f4").reshape(shape)
        color = None
        if told.get("color") is not None:
            color = np.frombuffer(base64.b64decode(told["color"]), np.uint8).reshape(*shape, 3)
        return RgbdFrame(float(told["time_s"]), camera, depth.copy(), color)
    except (KeyError, TypeError, ValueError) as error:
        raise ClothTrackError(f"the bridge's picture cannot be read: {error}") from error
