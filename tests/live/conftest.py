"""One small towel, its pictures as a driver hands them over."""

from dataclasses import dataclass
from pathlib import Path

import pytest

import clothtrack as ct
from clothtrack.live.playback import pickers_at


@dataclass(frozen=True)
class Film:
    """The pictures of a recording in memory."""

    recording: ct.Recording

    def picture(self, index):
        """The arguments of `update` for a frame."""
        recording, frame = self.recording, self.recording.frames[index]
        name = recording.cameras[0].name
        return {
            "time_s": frame.time_s,
            "depth": ct.read_depth(frame.depth[name], recording.depth_units_m[name]),
            "color": ct.read_color(frame.color[name]),
            "picker": pickers_at(recording, frame),
        }

    def tracker(self, **changes):
        """A tracker for the cloth of the recording."""
        recording = self.recording
        given = {"table": recording.table, "name": recording.name} | changes
        return ct.LiveTracker(recording.cloth, recording.cameras[0], **given)

    def follow(self, tracker, frames, *, by_call=True):
        """Hand frames over; actions begin and end as the recording says, or with the gripper."""
        states = []
        for index in frames:
            if by_call:
                for action in self.recording.actions:
                    if action.last_frame == index:
                        tracker.end_action()
                    if action.first_frame == index:
                        tracker.begin_action()
            states.append(tracker.update(**self.picture(index)))
        return states

    def __len__(self):
        return len(self.recording.frames)


@pytest.fixture(scope="session")
def film(napkin: Path) -> Film:
    return Film(ct.read_recording(napkin))
