"""A recording that is still being made: frames, actions and paths are added as they come."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.camera import Camera
from clothtrack.live.growing_frames import GrowingFrames
from clothtrack.recordings.recording import (
    WRITTEN_UNIT_M,
    ClothDescription,
    Frame,
    PickAndPlace,
    PickerPath,
    Recording,
    Table,
)


class GrowingPath:
    """Where a picker's tip was, sample by sample: 40 bytes each."""

    def __init__(self) -> None:
        """Begin without a sample."""
        self._samples = np.zeros((64, 5))
        self._count = 0

    def add(self, time_s: float, position: Float[np.ndarray, " 3"], closed: bool) -> bool:
        """Add a sample; another one of the last time replaces it, an older one is not taken."""
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
        """Return the path from the last sample up to this time [s] on."""
        times = self._samples[: self._count, 0]
        first = max(int(np.searchsorted(times, time_s, side="right")) - 1, 0)
        part = self._samples[first : self._count].copy()
        return PickerPath(part[:, 0].copy(), part[:, 1:4].copy(), part[:, 4] > 0.5)


class GrowingRecording:
    """Adds to a recording that the parts of the method already hold.

    Attributes:
        recording: what there is so far; a path begins where the latest action did.
        paths: the whole paths, by the picker's name.
    """

    def __init__(
        self, name: str, camera: Camera, table: Table | None, cloth: ClothDescription
    ) -> None:
        """Begin with no frame."""
        self._frames = GrowingFrames()
        self._actions: list[PickAndPlace] = []
        self._paths: dict[str, PickerPath] = {}
        self.paths: dict[str, GrowingPath] = {}
        self.recording = Recording(
            Path(name), (camera,), {camera.name: WRITTEN_UNIT_M}, self._frames, self._actions,
            self._paths, table, cloth,
        )  # fmt: skip

    def stand_on(self, camera: Camera, table: Table) -> None:
        """Put the camera into the world that a table gives."""
        self.recording = replace(self.recording, cameras=(camera,), table=table)

    def add_frame(self, frame: Frame) -> None:
        """Add a frame."""
        self._frames.add(frame)

    def take_back(self, frame: int) -> None:
        """Take the last frame back, and the action that begins with it."""
        self._frames.take_back()
        if self._actions and self._actions[-1].first_frame == frame:
            del self._actions[-1]

    def forget_pictures(self, index: int) -> None:
        """Take the pictures of a frame out of memory; the first frame's stay.

        Those where an action begins or ends go to a disk: labels are judged by them. All would fill
        it in an hour.
        """
        ends = {end for one in self._actions[-2:] for end in (one.first_frame, one.last_frame)}
        if index > 0:
            self._frames.put_away(index, keep=index in ends)

    def begin_action(self, first_frame: int) -> None:
        """Add an action; it ends where it begins, and nobody makes it, until that is known."""
        self._actions.append(PickAndPlace(first_frame, first_frame, ()))

    def change_action(
        self, place: int, *, last_frame: int | None = None, pickers: set[str] | None = None
    ) -> PickAndPlace:
        """Say by whom an action is, or where it ends; return it."""
        action = self._actions[place]
        if pickers is not None:
            action = replace(action, pickers=tuple(sorted(pickers)))
        if last_frame is not None:
            action = replace(action, last_frame=last_frame)
        self._actions[place] = action
        return action

    def drop_action(self, place: int) -> None:
        """Take an action back in which nothing happened."""
        del self._actions[place]

    def show_paths(self, first_frame: int) -> None:
        """Give the method what is known of the paths since a frame."""
        for name, path in self.paths.items():
            self._paths[name] = path.since(self._frames[first_frame].time_s)

    def finished(self) -> Recording:
        """Return the recording with whole paths, to be kept."""
        whole: Mapping[str, PickerPath] = {
            name: path.since(-np.inf) for name, path in self.paths.items()
        }
        return replace(
            self.recording, frames=self._frames, actions=tuple(self._actions),
            picker_paths=whole,
        )  # fmt: skip
