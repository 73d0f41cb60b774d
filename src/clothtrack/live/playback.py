"""Playback of a recording in real time, like a live camera."""

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
    """Send every picture of a recording to a stream at its time.

    Actions begin and end as in the recording, or with the gripper if the recording has none. The
    first picture is processed before the others start because the first mesh takes longest.
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
    """Return the pickers' positions in a frame, and whether they are closed."""
    return {
        name: (path.position_at(frame.time_s), path.closed_at(frame.time_s))
        for name, path in recording.picker_paths.items()
    }


@dataclass
class Latencies:
    """Latencies from the arrival of a picture to its mesh, and the number of dropped pictures.

    Attributes:
        first_s: latency of the first picture, which includes the first mesh [s].
        each_s: latencies of all later processed pictures [s].
        dropped: number of pictures that were not processed.
    """

    first_s: float = math.nan
    each_s: list[float] = field(default_factory=list)
    dropped: int = 0
    _newest: int = -1

    def add(self, state: LiveState) -> None:
        """Add a processed picture; states that only report a stall do not count."""
        if state.frame == self._newest:
            return
        self._newest = state.frame
        if math.isnan(self.first_s):
            self.first_s = state.latency_s
        else:
            self.each_s.append(state.latency_s)
        self.dropped = state.dropped

    @property
    def served(self) -> int:
        """Number of processed pictures."""
        return len(self.each_s) + (not math.isnan(self.first_s))

    def text(self) -> str:
        """Return median, 95th percentile and dropped pictures in one line."""
        arrived, times = self.served + self.dropped, self.as_dict()
        share = 100.0 * self.dropped / max(arrived, 1)
        later = "{median_s:.0f} ms median, {p95_s:.0f} ms for 95 %, "
        later = later.format(**{name: 1e3 * value for name, value in times.items()})
        return (
            f"{later if self.each_s else ''}{self.dropped} of {arrived} pictures dropped "
            f"({share:.0f} %), first mesh after {self.first_s:.2f} s"
        )

    def as_dict(self) -> dict[str, float | int]:
        """Return the same as plain JSON values."""
        some = self.each_s or [math.nan]
        median, most = np.percentile(some, [50, 95]).tolist()
        return {
            "median_s": median,
            "p95_s": most,
            "first_mesh_s": self.first_s,
            "served": self.served,
            "dropped": self.dropped,
        }
