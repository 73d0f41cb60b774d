"""A growing recording, to which frames, actions and paths are added as they arrive."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.table_plane import world_from_table
from clothtrack.live.growing_frames import GrowingFrames
from clothtrack.recordings.recorded_table import fit_recorded_table
from clothtrack.recordings.recording import (
    WRITTEN_UNIT_M,
    ClothDescription,
    PickAndPlace,
    PickerPath,
    Recording,
    Table,
)

Picker = Mapping[str, tuple[Sequence[float] | Float[np.ndarray, " 3"], bool]]
"""Tip position in the world [m], and whether the picker is closed, by the picker's name."""


class GrowingPath:
    """Sampled path of a picker's tip, with 40 bytes per sample."""

    def __init__(self) -> None:
        """Create an empty path."""
        self._samples = np.zeros((64, 5))
        self._count = 0

    def add(self, time_s: float, position: Float[np.ndarray, " 3"], closed: bool) -> bool:
        """Add a sample; one of equal time replaces the last, an older one is rejected."""
        if self._count and time_s <= self.latest_s:
            if time_s < self.latest_s:
                return False
            self._count -= 1
        if self._count == len(self._samples):
            self._samples = np.concatenate([self._samples, np.zeros_like(self._samples)])
        self._samples[self._count] = (time_s, *position, closed)
        self._count += 1
        return True

    @property
    def closed(self) -> bool:
        """Whether the picker is closed now."""
        return bool(self._samples[self._count - 1, 4])

    @property
    def latest_s(self) -> float:
        """Time of the last sample [s]."""
        return float(self._samples[self._count - 1, 0])

    def since(self, time_s: float) -> PickerPath:
        """Return the path from the last sample at or before this time [s] on."""
        times = self._samples[: self._count, 0]
        first = max(int(np.searchsorted(times, time_s, side="right")) - 1, 0)
        part = self._samples[first : self._count].copy()
        return PickerPath(part[:, 0].copy(), part[:, 1:4].copy(), part[:, 4] > 0.5)


class GrowingRecording:
    """Writer of a recording that the components of the method share.

    Attributes:
        recording: the recording so far; its paths begin with the latest action.
        frames: its frames, which the caller adds.
        zero_s: start of the recording on the caller's clock [s]; 0 before it begins.
    """

    def __init__(
        self, name: str, camera: Camera, table: Table | None, cloth: ClothDescription
    ) -> None:
        """Create a recording without frames."""
        self.frames = GrowingFrames()
        self._actions: list[PickAndPlace] = []
        self._paths: dict[str, PickerPath] = {}
        self.paths: dict[str, GrowingPath] = {}
        self.zero_s, self._begun = 0.0, False
        self.recording = Recording(
            Path(name), (camera,), {camera.name: WRITTEN_UNIT_M}, self.frames, self._actions,
            self._paths, table, cloth,
        )  # fmt: skip

    def since_start(self, time_s: float) -> float:
        """Convert a time [s] to the time since the first one passed to this method."""
        if not self._begun:
            self.zero_s, self._begun = float(time_s), True
        return float(time_s) - self.zero_s

    def next_time(self, time_s: float) -> float:
        """Return the time of the next frame since the start [s]."""
        at_s, frames = self.since_start(time_s), self.frames
        if not np.isfinite(at_s) or (frames and not at_s > frames[-1].time_s):
            raise InvalidRecordingError(
                f"a picture of {time_s} s follows one of {frames[-1].time_s + self.zero_s} s; "
                "give pictures in order of time, in seconds"
                if frames
                else f"a picture of {time_s} s; give seconds"
            )
        return at_s

    def move_picker(self, at_s: float, picker: Picker) -> list[str]:
        """Add samples to the pickers' paths, at a time since the start [s]; return notes."""
        notes = []
        for name, (position, closed) in picker.items():
            tip = np.asarray(position, np.float64)
            if tip.shape != (3,) or not np.isfinite(tip).all():
                raise InvalidRecordingError(
                    f"picker {name!r} is at {position!r:.80}; give x, y and z in the world [m]"
                )
            path = self.paths.setdefault(name, GrowingPath())
            if not path.add(at_s, tip, bool(closed)):
                notes.append(f"picker {name}: a sample that is older than the last")
        return notes

    def find_table(self) -> None:
        """Find the table in the first picture, and the world frame if the camera has no pose."""
        (camera,) = self.recording.cameras
        fit = fit_recorded_table(self.recording, camera)
        if np.array_equal(camera.world_from_camera, np.eye(4)):
            camera = replace(camera, world_from_camera=world_from_table(camera, fit))
            table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
        else:
            normal = camera.world_from_camera[:3, :3] @ fit.normal
            table = Table(camera.position - fit.distance_m * normal, normal)
        self.recording = replace(self.recording, cameras=(camera,), table=table)

    def take_back(self, frame: int) -> None:
        """Remove the last frame, and the action that begins with it."""
        self.frames.take_back()
        if self._actions and self._actions[-1].first_frame == frame:
            del self._actions[-1]

    def forget_pictures(self, index: int) -> None:
        """Remove the pictures of a frame from memory, except those of the first frame.

        Pictures at the beginning or end of an action go to disk because labels are judged by them.
        All pictures would fill the disk in an hour.
        """
        ends = {end for one in self._actions[-2:] for end in (one.first_frame, one.last_frame)}
        if index > 0:
            self.frames.put_away(index, keep=index in ends)

    def begin_action(self, first_frame: int) -> None:
        """Add an action that ends at its first frame and has no pickers until these are known."""
        self._actions.append(PickAndPlace(first_frame, first_frame, ()))

    def change_action(
        self, place: int, *, last_frame: int | None = None, pickers: set[str] | None = None
    ) -> PickAndPlace:
        """Set the pickers or the last frame of an action, and return it."""
        action = self._actions[place]
        if pickers is not None:
            action = replace(action, pickers=tuple(sorted(pickers)))
        if last_frame is not None:
            action = replace(action, last_frame=last_frame)
        self._actions[place] = action
        return action

    def drop_action(self, place: int) -> None:
        """Remove an action in which nothing happened."""
        del self._actions[place]

    def show_paths(self, first_frame: int) -> None:
        """Update the recording's paths from a frame on."""
        for name, path in self.paths.items():
            self._paths[name] = path.since(self.frames[first_frame].time_s)

    def finished(self) -> Recording:
        """Return the finished recording with whole paths."""
        whole: Mapping[str, PickerPath] = {
            name: path.since(-np.inf) for name, path in self.paths.items()
        }
        return replace(
            self.recording, frames=self.frames, actions=tuple(self._actions),
            picker_paths=whole,
        )  # fmt: skip
