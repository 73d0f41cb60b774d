"""Live tracking of one action."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from clothtrack.live.growing_recording import GrowingRecording
from clothtrack.recordings.geometry_checks.finding import ObservedFrames
from clothtrack.recordings.geometry_checks.picker import (
    FARTHEST_LAG_S,
    LAG_FRAMES,
    ClockLag,
    picker_lag,
)
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, PickAndPlace, PickerPath
from clothtrack.simulation.picker_action import PickerAction
from clothtrack.tracking.algorithm import Tracked, begin_action, end_action, track_frame
from clothtrack.tracking.methods import Components
from clothtrack.tracking.picking import HeldCloth
from clothtrack.tracking.protocols import Candidate, Method, State
from clothtrack.tracking.recorder import Recorder
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.tracked_trajectory import Calibration

SETTLE_S = 0.2
"""Time from the first picture without a closed picker to the end of the action [s]."""


LONGEST_GAP_S = 0.2
"""Longest roll-out of the dynamics over dropped pictures [s]. If they are slower than the camera, a
longer gap would take more time, and make the next gap even longer."""


@dataclass(frozen=True, eq=False)
class HurriedCloth(HeldCloth):
    """Grasps that follow their whole path over a gap of dropped pictures in less time."""

    def action(self, start_s: float, end_s: float) -> PickerAction:
        """Return the action of the closed pickers between two times [s], shortened."""
        action = super().action(start_s, end_s)
        share = min(1.0, LONGEST_GAP_S / action.duration_s)
        return replace(action, duration_s=share * action.duration_s, speed=action.speed / share)


class LiveAction:
    """Tracker of the action in progress, the latest of its recording."""

    def __init__(
        self,
        growing: GrowingRecording,
        components: Components,
        method: Method,
        recorder: Recorder,
        *,
        state: State,
        theta: Theta,
        first: Frame,
        by_gripper: bool,
    ) -> None:
        """Begin with a frame in which the cloth lies still."""
        begin_action(first, state, method)
        self._growing, self._components = growing, components
        self._method, self._recorder = method, recorder
        self._first, self._start, self._theta = first, state, theta
        self._by_gripper, self._opened_s = by_gripper, np.inf
        self._held, self._closed = HeldCloth((), np.zeros(3)), set[str]()
        self._paths: Mapping[str, PickerPath] = {}
        self._times_s: list[float] = []
        self._seen: list[tuple[float, Observation]] = []
        self._stride = 1
        self._place = len(growing.recording.actions) - 1
        action = growing.recording.actions[self._place]
        self._notes = recorder.begin(action, Candidate(theta, self._held))
        self._dyn = method.dynamics(theta)
        self._tracked = Tracked(state, first, first)

    @property
    def state(self) -> State:
        """Current state of the cloth."""
        return self._tracked.state

    @property
    def first_frame(self) -> int:
        """Number of the first frame."""
        return self._first.index

    @property
    def tracked_frame(self) -> Frame:
        """Last tracked frame."""
        return self._tracked.frame

    @property
    def held(self) -> dict[str, tuple[int, ...]]:
        """Vertices that each picker holds or has held, by its name."""
        return self._held.held_vertices

    def spent_s(self, frame: Frame) -> dict[str, float]:
        """Return the CPU time of each step of a frame [s], by its name."""
        return self._notes.spent_s(frame)

    def grasp(self, frame: Frame, closed: set[str]) -> None:
        """Find the grasps of newly closed pickers, in the cloth at the start of the action."""
        if closed <= self._closed:
            return
        self._closed |= closed
        action = self._growing.change_action(self._place, pickers=self._closed)
        span = PickAndPlace(self._first.index, frame.index, action.pickers)
        self._held = self._components.pick(span, self._start, self._theta)

    def step(self, frame: Frame) -> None:
        """Track the cloth into the next frame."""
        grasps = self._grasps(self._growing.recording.picker_paths)
        if frame.index > self._tracked.frame.index + 1:
            grasps = HurriedCloth(grasps.grasps, grasps.offset)
        self._tracked = track_frame(
            self._dyn, self._tracked, grasps, frame, method=self._method, notes=self._notes
        )

    def note_seen(self, frame: Frame, seen: Observation) -> None:
        """Record the observation of a tracked frame, and the paths so far."""
        self._paths = dict(self._growing.recording.picker_paths)
        if len(self._times_s) % self._stride == 0:
            self._seen.append((frame.time_s, seen))
        self._times_s.append(frame.time_s)
        if len(self._seen) > 2 * LAG_FRAMES:
            del self._seen[1::2]
            self._stride *= 2

    def stay(self, frame: Frame) -> None:
        """Keep the mesh unchanged in a frame that shows no cloth."""
        self._notes.rest(frame, self.state)

    def is_over(self, frame: Frame, closed: set[str]) -> bool:
        """Return whether the cloth has had time to settle since the pickers opened."""
        if self._by_gripper and not closed:
            self._opened_s = min(self._opened_s, frame.time_s)
        return frame.time_s - self._opened_s >= SETTLE_S - 1e-6

    def let_go(self) -> bool:
        """Return whether the pickers have opened."""
        return bool(np.isfinite(self._opened_s))

    def announce_last(self, frame: int | None) -> None:
        """Set the last frame of the action before observing it; None: it is not known yet."""
        last = self.first_frame if frame is None else frame
        self._growing.change_action(self._place, last_frame=last)

    def end(self, last: Frame) -> tuple[Theta, State] | None:
        """End the action with a tracked frame, and run its final alignment (TTO2)."""
        count = last.index - self._first.index
        if count == 0:
            self._growing.drop_action(self._place)
            return None
        action = self._growing.change_action(self._place, last_frame=last.index)
        tracked = self._notes.finished(self.state)
        tracked = replace(
            tracked, action=action, candidate=Candidate(self._theta, self._grasps(self._paths)),
            positions=tracked.positions[:count],
        )  # fmt: skip
        return end_action(
            self._growing.recording, tracked, self.state, Calibration.none(),
            method=self._method, recorder=self._recorder,
        )  # fmt: skip

    def picker_lag(self) -> ClockLag | None:
        """Return the lag of the pickers' clock in the ended action; None if there is none."""
        since_s = self._times_s[0] - FARTHEST_LAG_S
        recording = replace(
            self._growing.recording,
            frames=[Frame(index, time_s) for index, (time_s, _) in enumerate(self._seen)],
            actions=[PickAndPlace(0, len(self._seen) - 1, tuple(sorted(self._closed)))],
            picker_paths={name: path.since(since_s) for name, path in self._growing.paths.items()},
        )
        frames = ObservedFrames(recording, cloud=lambda frame: self._seen[frame.index][1])
        lag = picker_lag(frames)
        return lag if lag is not None and lag.is_wrong(self._times_s) else None

    def _grasps(self, paths: Mapping[str, PickerPath]) -> HeldCloth:
        """Return the grasps with the current paths."""
        grasps = [replace(one, path=paths[one.picker]) for one in self._held.grasps]
        return replace(self._held, grasps=tuple(grasps))
