"""A robot that does not move; it writes its actions as JSON and as arrows on the picture."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.files.atomic_write import write_file
from clothtrack.planning.action_space import PickPlace
from clothtrack.planning.arrows import draw_action, shown_depth
from clothtrack.planning.robots.robot import (
    Execution,
    MotionLimits,
    Reachability,
    RgbdFrame,
    waypoints,
)
from clothtrack.recordings.pictures import encode_png, read_color, read_depth
from clothtrack.recordings.recording import PickerPath, Recording

STOPPED = "dry run: nothing moved"


class DryRunRobot:
    """Robot that only writes its actions; the episode ends after the first."""

    def __init__(
        self,
        picture: Callable[[], RgbdFrame],
        folder: Path,
        *,
        limits: MotionLimits | None = None,
    ) -> None:
        """Set the source of pictures, the output folder and the motion limits."""
        self._take = picture
        self.folder, self.limits = Path(folder), limits or MotionLimits()
        self._latest: RgbdFrame | None = None

    def observe(self) -> RgbdFrame:
        """Return a picture."""
        self._latest = self._take()
        return self._latest

    def check(self, action: PickPlace) -> Reachability:
        """Return whether the path of the tip is within the limits."""
        reason = self.limits.refusal(waypoints(action))
        return Reachability(not reason, reason)

    def execute(self, action: PickPlace) -> Execution:
        """Write the action without moving."""
        reachability = self.check(action)
        if not reachability.reachable:
            raise InvalidConfigError(f"refused: {reachability.reason}")
        frame = self._latest or self.observe()
        number = len(list(self.folder.glob("action_*.json")))
        points = waypoints(action)
        text = {**action.as_dict(), "frame": "world", "unit": "m", "waypoints": points.tolist()}
        shown = shown_depth(frame.depth_m) if frame.color is None else frame.color
        drawn = draw_action(shown, frame.camera, action)
        write_file(self.folder / f"action_{number:02d}.json", json.dumps(text, indent=1).encode())
        write_file(self.folder / f"action_{number:02d}.png", encode_png(drawn))
        times = frame.time_s + 0.5 * np.arange(1, len(points) + 1)
        closed = np.array([False, True, True, True, False, False])
        # The next picture has a later time, so the step is a complete recording.
        return Execution(PickerPath(times, points, closed), (frame,), None, STOPPED)

    def home(self) -> None:
        """Do nothing, because there is no arm in the view."""


def pictures_of(recording: Recording) -> Callable[[], RgbdFrame]:
    """Return a function that repeats a recording's last picture, each time one second later."""
    frame, count = recording.frames[-1], 0

    def take() -> RgbdFrame:
        nonlocal count
        camera = next((one for one in recording.cameras if one.name in frame.depth), None)
        if camera is None:
            raise InvalidConfigError(
                f"{recording.folder}: its last frame has no depth picture to plan from"
            )
        depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
        color = read_color(frame.color[camera.name]) if camera.name in frame.color else None
        count += 1
        return RgbdFrame(float(count - 1), camera, depth, color)

    return take
