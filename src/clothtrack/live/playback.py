"""Play a recording at the speed of its clock, as if its camera were on now."""

import math
import time
from dataclasses import dataclass, field

import numpy as np

from clothtrack.live.growing_recording import Picker
from clothtrack.live.live_state import LiveState
from clothtrack.live.live_stream import LiveStream
from clothtrack.recordings.pictures import read_color, read_depth, read_mask
from clothtrack.recordings.recording import Frame, Recording


def play(recording: Recording, stream: LiveStream) -> None:
    """Hand every picture of a recording to a stream when its time has come.

    Actions begin and end where the recording says so; where it names none, with the gripper. The
    first picture is waited for: the first mesh takes longer than any later one.

    Args:
        recording: with depth of its first camera.
        stream: takes the pictures; each is read from disk before its time has come.

    Raises:
        InvalidRecordingError: a picture cannot be read.
    """
    camera = recording.cameras[0].name
    unit_m = recording.depth_units_m[camera]
    starts = {action.first_frame for action in recording.actions}
    ends = {action.last_frame for action in recording.actions}
    begun_s = None
    for frame in (one for one in recording.frames if camera in one.depth):
        depth = read_depth(frame.depth[camera], unit_m)
        color = read_color(frame.color[camera]) if camera in frame.color else None
        mask = read_mask(frame.mask[camera]) if camera in frame.mask else None
        if begun_s is not None:
            due_s = begun_s + frame.time_s - recording.frames[0].time_s
            time.sleep(max(0.0, due_s - time.monotonic()))
        if frame.index in ends:
            stream.end_action()
        if frame.index in starts:
            stream.begin_action()
        stream.put(frame.time_s, depth, color, mask, pickers_at(recording, frame))
        if begun_s is None:
            stream.wait()
            begun_s = time.monotonic()


def pickers_at(recording: Recording, frame: Frame) -> Picker:
    """Return where the pickers of a recording are in a frame, and whether they are closed."""
    return {
        name: (path.position_at(frame.time_s), path.closed_at(frame.time_s))
        for name, path in recording.picker_paths.items()
    }


@dataclass
class Latencies:
    """How long pictures took from their arrival to their mesh, and what was dropped.

    Attributes:
        first_s: of the first picture, which makes the first mesh [s].
        each_s: of all later ones that were served [s].
        dropped: pictures that were not served.
    """

    first_s: float = math.nan
    each_s: list[float] = field(default_factory=list)
    dropped: int = 0
    _newest: int = -1

    def add(self, state: LiveState) -> None:
        """Count a picture that was served; a state that only says what stalls is none."""
        if state.frame == self._newest:
            return
        self._newest = state.frame
        if math.isnan(self.first_s):
            self.first_s = state.latency_s
        else:
            self.each_s.append(state.latency_s)
        self.dropped = state.dropped

    def text(self) -> str:
        """Return median, 95 % and what was dropped, in a line."""
        served = len(self.each_s) + (not math.isnan(self.first_s))
        share = 100.0 * self.dropped / max(served + self.dropped, 1)
        words = f"{self.dropped} of {served + self.dropped} pictures dropped ({share:.0f} %)"
        if not self.each_s:
            return f"{words}, first mesh after {self.first_s:.2f} s"
        median, most = 1e3 * np.percentile(self.each_s, [50, 95])
        return (
            f"{median:.0f} ms median, {most:.0f} ms for 95 %, {words}, "
            f"first mesh after {self.first_s:.2f} s"
        )

    def as_dict(self) -> dict[str, float | int]:
        """Return the same as JSON holds it."""
        some = self.each_s or [math.nan]
        median, most = np.percentile(some, [50, 95]).tolist()
        return {
            "median_s": median,
            "p95_s": most,
            "first_mesh_s": self.first_s,
            "served": len(self.each_s) + 1,
            "dropped": self.dropped,
        }
