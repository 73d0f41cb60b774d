"""A robot behind ROS 2 for clothtrack: run this in your ROS environment's own Python.

    source /opt/ros/jazzy/setup.bash
    python3 ros2_bridge.py --port 5555          # moves nothing
    python3 ros2_bridge.py --port 5555 --move   # may move

clothtrack connects with `BridgeRobot(5555)` of `bridge_robot.py` beside this file. One request is
one line of JSON, one answer is one line; only this machine can connect. It needs rclpy and numpy,
not clothtrack. `MoveArm` is where your MoveIt, or whatever moves your arm, comes in: a template
that you fill in, not a driver.
"""

import argparse
import base64
import json
import math
import socketserver
import sys
import threading
import time
from pathlib import Path

WORKSPACE_M = ((0.3, 0.7), (-0.3, 0.3), (0.002, 0.5))
"""Where the finger tips may be, in the world frame [m]; checked here, whoever asks."""


class MoveArm:
    """Your arm. Positions are of the finger tips in the world frame [m], fingers down."""

    def go(self, x, y, z):
        """Straight there, and stop. Fill in: MoveIt's computeCartesianPath, at a low speed."""
        raise NotImplementedError("fill in MoveArm.go for your arm")

    def here(self):
        """Where the tips are: tf2 from the world frame to the tips."""
        raise NotImplementedError("fill in MoveArm.here for your arm")

    def open(self):
        """Open the fingers."""
        raise NotImplementedError("fill in MoveArm.open for your gripper")

    def close(self):
        """Close the fingers; whether they hold something, None if they cannot tell."""
        raise NotImplementedError("fill in MoveArm.close for your gripper")

    def home(self):
        """Out of the camera's view."""
        raise NotImplementedError("fill in MoveArm.home for your arm")


class Eyes:
    """The latest aligned depth, color and camera info of a RealSense-like driver."""

    def __init__(self, node, world_from_camera):
        from sensor_msgs.msg import CameraInfo, Image

        self._pose, self._latest, self._lock = world_from_camera, {}, threading.Lock()
        for name, kind, topic in (
            ("depth", Image, "/camera/aligned_depth_to_color/image_raw"),
            ("color", Image, "/camera/color/image_raw"),
            ("info", CameraInfo, "/camera/color/camera_info"),
        ):
            node.create_subscription(kind, topic, self._keeper(name), 1)

    def _keeper(self, name):
        def keep(message):
            with self._lock:
                self._latest[name] = message

        return keep

    def frame(self):
        """The picture as a line of JSON holds it."""
        import numpy as np

        with self._lock:
            latest = dict(self._latest)
        if not {"depth", "info"} <= set(latest):
            raise RuntimeError("no depth picture has come yet; is the camera driver running?")
        depth, info = latest["depth"], latest["info"]
        unit = 0.001 if depth.encoding == "16UC1" else 1.0
        kind = np.uint16 if depth.encoding == "16UC1" else np.float32
        meters = np.nan_to_num(np.frombuffer(depth.data, kind).astype(np.float32) * unit)
        color = latest.get("color")
        shown = None
        if color is not None:
            rgb = np.frombuffer(color.data, np.uint8).reshape(color.height, color.width, 3)
            rgb = rgb[..., ::-1] if color.encoding == "bgr8" else rgb
            shown = base64.b64encode(np.ascontiguousarray(rgb).tobytes()).decode()
        return {
            "time_s": time.monotonic(),
            "camera": {
                "name": "top", "width": info.width, "height": info.height,
                "fx": info.k[0], "fy": info.k[4], "cx": info.k[2], "cy": info.k[5],
                "world_from_camera": self._pose,
            },
            "depth_m": base64.b64encode(meters.astype("<f4").tobytes()).decode(),
            "color": shown,
        }  # fmt: skip


class Bridge:
    """Answers the four methods."""

    def __init__(self, arm, eyes, *, may_move):
        self._arm, self._eyes, self._may_move = arm, eyes, may_move

    def answer(self, request):
        """One answer for one request."""
        method = request.get("method")
        if method == "observe":
            return self._eyes.frame()
        if method == "check":
            reason = self.refusal(request["action"])
            return {"reachable": not reason, "reason": reason}
        if method == "execute":
            return self._execute(request["action"])
        if method == "home":
            self._require_motion()
            self._arm.home()
            return {}
        raise ValueError(f"method {method!r} is none of observe, check, execute, home")

    @staticmethod
    def way(action):
        """The way of the tips: over the pick, down, up, across, down, up."""
        pick, place, lift = action["pick"], action["place"], float(action["lift_m"])
        high = max(pick[2], place[2]) + lift
        return [
            [*pick[:2], high], pick, [*pick[:2], high], [*place[:2], high], place,
            [*place[:2], high],
        ]  # fmt: skip

    def refusal(self, action):
        """Why the action is not carried out; empty when it may be."""
        for point in self.way(action):
            for axis, value, (low, high) in zip("xyz", point, WORKSPACE_M, strict=True):
                if not (math.isfinite(value) and low <= value <= high):
                    return f"the tips would be at {axis} = {value} m, outside {low} to {high}"
        return ""

    def _require_motion(self):
        if not self._may_move:
            raise PermissionError("the bridge was started without --move")

    def _execute(self, action):
        reason = self.refusal(action)
        if reason:
            raise ValueError(f"refused before moving: {reason}")
        self._require_motion()
        times, positions, closed, film, grasped, error = [], [], [], [], None, ""
        try:
            self._arm.open()
            for number, point in enumerate(self.way(action)):
                self._arm.go(*point)
                if number == 1:
                    grasped = self._arm.close()
                if number == 4:
                    self._arm.open()
                picture = self._eyes.frame()
                film.append(picture)
                times.append(picture["time_s"])
                positions.append(list(self._arm.here()))
                closed.append(1 <= number < 4)
        except Exception as failure:  # noqa: BLE001 - the arm has stopped, and its operator is told
            sys.stderr.write(f"the arm stopped: {failure}\n")
            error = str(failure) or type(failure).__name__
        return {
            "time_s": times, "positions": positions, "closed": closed, "film": film,
            "grasped": grasped, "error": error,
        }  # fmt: skip


class Connection(socketserver.StreamRequestHandler):
    """One client."""

    def handle(self):
        """Answer line by line; what fails is told, and the connection stays."""
        for line in self.rfile:
            try:
                answer = self.server.bridge.answer(json.loads(line))
            except Exception as failure:  # noqa: BLE001 - the arm has stopped, and its operator is told
                sys.stderr.write(f"{failure}\n")
                answer = {"failed": str(failure) or type(failure).__name__}
            self.wfile.write(json.dumps(answer).encode() + b"\n")


def serve(bridge, port):
    """A server on 127.0.0.1 that answers for the bridge, one client at a time."""
    server = socketserver.TCPServer(("127.0.0.1", port), Connection)
    server.bridge = bridge
    return server


def main():
    """Start the node and the server."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", type=int, default=5555)
    parser.add_argument("--pose", default="", help="JSON file with world_from_camera, 4 x 4")
    parser.add_argument("--move", action="store_true", help="let the arm move")
    options = parser.parse_args()
    import rclpy

    rclpy.init()
    node = rclpy.create_node("clothtrack_bridge")
    pose = [[float(row == column) for column in range(4)] for row in range(4)]
    if options.pose:
        pose = json.loads(Path(options.pose).read_text(encoding="utf-8"))["world_from_camera"]
    eyes = Eyes(node, pose)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    with serve(Bridge(MoveArm(), eyes, may_move=options.move), options.port) as server:
        server.serve_forever()


if __name__ == "__main__":
    main()
