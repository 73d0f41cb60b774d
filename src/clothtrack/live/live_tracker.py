"""Tracking of a cloth picture by picture, as they come from the camera.

The steps are those of `tracking.algorithm`, in the same order, and the same pictures give the same
result bit for bit as `track` without a search. The final alignment of an action (TTO2) runs in
parallel with the stream, and pictures may be missing.
"""

import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import cache
from typing import Literal

import numpy as np

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.live.growing_frames import Eyes
from clothtrack.live.growing_recording import GrowingRecording, Picker
from clothtrack.live.live_action import LiveAction, LiveParts
from clothtrack.live.live_judge import LiveJudge
from clothtrack.live.live_state import LiveState
from clothtrack.recordings.geometry_checks.picker import ClockLag
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import ClothDescription, Frame, Recording, Table
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.tracking.configuration import InitialStateConfig, ModeName, RunConfig
from clothtrack.tracking.configuration import mode as settings_of_mode
from clothtrack.tracking.methods import METHODS, Components
from clothtrack.tracking.pipeline import Judge, checked_initial_state, observer, provenance
from clothtrack.tracking.protocols import State, Watch
from clothtrack.tracking.recorder import Recorder
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

_CLOUDS_KEPT = 3
"""Number of cached clouds: this frame, the one before, and the reference of resting cloth."""

_FOLLOWED_KEPT = 64
"""Number of frames with cached followed points. The final alignment of an action needs those of its
last frame a moment later."""


class LiveTracker:
    """Live tracker of one cloth.

    Call `update` with every picture, in order. An action begins with the first picture in which a
    picker is closed. It ends with the first picture 0.2 s after all pickers have opened. Between
    actions the mesh rests. Without a gripper, call `begin_action` and `end_action`.
    """

    def __init__(
        self,
        cloth: ClothDescription,
        camera: Camera,
        *,
        table: Table | Literal["find"] | None = None,
        config: RunConfig | None = None,
        segmenter: Segmenter | None = None,
        device: str = "cpu",
        watch: Watch | None = None,
        name: str = "live",
        keep_pictures: bool = False,
        force: bool = False,
        warm: bool = True,
    ) -> None:
        """Load what the first picture needs; `warm` tracks a small cloth first, once a process."""
        config = config or RunConfig()
        self._config = replace(config, search=replace(config.search, method="none"))
        self._find_table = isinstance(table, str)
        self._growing = GrowingRecording(
            name, camera, None if isinstance(table, str) else table, cloth
        )
        self._segmenter, self._device, self._watch = segmenter, device, watch
        self._keep_pictures, self._force = keep_pictures, force
        self._eyes = Eyes()
        self._finisher = ThreadPoolExecutor(1, thread_name_prefix="clothtrack-final")
        self._parts: LiveParts | None = None
        self._action: LiveAction | None = None
        self._over: tuple[LiveAction, Frame] | None = None
        self._final: Future[tuple[Theta, State] | None] | None = None
        self._lags: list[Future[ClockLag | None]] = []
        self._lag: ClockLag | None = None
        self._seen_from: tuple[np.ndarray, np.ndarray] | None = None
        self._closed_before = set[str]()
        self._begins = self._ends = False
        self._dropped = 0
        self._notes: list[str] = []
        self._spent_s: dict[str, float] = {}
        self._closed = False
        if warm:
            _warm_up(self._config.mode, self._config.color, device)

    @property
    def segmenter(self) -> Segmenter | None:
        """Segmentation of the cloth, if one was given."""
        return self._segmenter

    @property
    def camera(self) -> Camera:
        """Camera with its pose in the world."""
        return self._growing.recording.cameras[0]

    @property
    def recording(self) -> Recording:
        """The growing recording."""
        return self._growing.recording

    @property
    def mesh(self) -> ClothMesh | None:
        """Flat cloth with topology and rest shape; None before the first picture."""
        return None if self._parts is None else self._parts.components.mesh

    @property
    def dropped(self) -> int:
        """Number of pictures that were not processed."""
        return self._dropped

    def begin_action(self) -> None:
        """Begin an action with the next picture, regardless of the gripper."""
        self._begins = True

    def end_action(self) -> None:
        """End the current action with the next picture."""
        self._ends = self._action is not None or self._begins

    def move_picker(self, time_s: float, picker: Picker) -> None:
        """Add the pickers' positions at a time between pictures.

        Args:
            time_s: time of the positions [s], on the clock of the pictures.
            picker: position of each tip in the world [m], and whether it is closed.

        Raises:
            InvalidRecordingError: a position is not three finite numbers.
        """
        self._notes += self._growing.move_picker(self._growing.since_start(time_s), picker)

    def drop(self, time_s: float, picker: Picker | None = None) -> None:
        """Record a dropped picture; the mesh rests, but the picker's path is used.

        Args:
            time_s: time of the picture [s].
            picker: as for `update`.

        Raises:
            InvalidRecordingError: the picture is older than the last one.
        """
        self.move_picker(time_s, picker or {})
        frame = Frame(len(self.recording.frames), self._growing.next_time(time_s))
        self._dropped += 1
        if self._parts is None:
            return
        self._growing.frames.add(frame)
        if self._action is not None:
            self._action.stay(frame)

    def update(
        self,
        time_s: float,
        depth: np.ndarray,
        color: np.ndarray | None = None,
        mask: np.ndarray | None = None,
        picker: Picker | None = None,
    ) -> LiveState:
        """Track the cloth into the next picture and return its state.

        Args:
            time_s: time of the picture [s], later than the one before.
            depth: (height, width) float, along the optical axis [m]; 0 where nothing was measured.
            color: (height, width, 3) uint8, red first.
            mask: (height, width) bool, mask of the cloth.
            picker: position of each tip in the world [m] at that time, and whether it is closed.

        Raises:
            InvalidRecordingError: a picture or a position is of the wrong size, type or order; the
                first picture shows no cloth, or the first mesh is too far from it.
        """
        began = time.perf_counter()
        if self._closed:
            raise InvalidConfigError("the tracker is closed; make another one")
        self._finish(wait=False)
        self._compare_clocks(wait=False)
        self.move_picker(time_s, picker or {})
        index = len(self.recording.frames)
        frame = Frame.of_arrays(
            index, self._growing.next_time(time_s), self.camera, depth=depth,
            color=None if color is None else np.array(color), mask=mask,
        )  # fmt: skip
        self._growing.frames.add(frame)
        closed = {name for name, path in self._growing.paths.items() if path.closed}
        begins, ends = self._turn(frame, closed)
        if self._parts is None:
            try:
                self._parts = self._start(frame)
            except BaseException:
                self._growing.take_back(frame.index)
                raise
        seen = self._track(frame, self._parts, closed, begins=begins, ends=ends)
        if index and not self._keep_pictures:
            self._growing.forget_pictures(index - 1)
        state = self._state(frame, self._parts, seen, began)
        if self._over is not None and self._final is None:
            # The simulator is free until the next action begins.
            self._final = self._finisher.submit(self._over[0].end, self._over[1])
        return state

    def tracked(
        self, recording: Recording | None = None, judge: Judge | None = None
    ) -> tuple[TrackedTrajectory, Recording]:
        """End the current action; return the tracked trajectory and its recording.

        Args:
            recording: the recording that was played, if any; by default the live recording.
            judge: function that computes the verdict; none by default.

        Raises:
            InvalidConfigError: there was no picture.
        """
        if self._parts is None:
            raise InvalidConfigError("there was no picture; nothing was tracked")
        parts = self._parts
        if self._action is not None:
            self._end(self._action, self._action.tracked.frame)
        self._finish(wait=True)
        self._compare_clocks(wait=True)
        self._closed = True
        self._eyes.close()
        self._finisher.shutdown()
        parts.judge.close()
        source = recording or self._growing.finished()
        stamp = provenance(source, self._config, self._device) | {
            "initial_state": dict(parts.origin),
            "first_mesh_gap_m": parts.gap_m,
            "live": {
                "dropped": self._dropped,
                "picker_lag_s": None if self._lag is None else self._lag.lag_s,
            },
        }
        if self._segmenter is not None:
            stamp["replaced_parts"] = ["segmenter"]
        tracked = replace(
            parts.recorder.trajectory(), name=source.name, config=asdict(self._config),
            provenance=stamp,
        )  # fmt: skip
        if judge is not None:
            verdict = judge(tracked, source, segmenter=self._segmenter, device=self._device)
            tracked = replace(tracked, verdict_fields=verdict)
        return tracked, source

    def _start(self, frame: Frame) -> LiveParts:
        """Find the first mesh and create its method."""
        if self._find_table:
            self._growing.find_table()
        self._growing.show_paths(frame.index)
        recording, device = self.recording, self._device
        self._eyes.cloud = observer(
            recording, self._config.cloud_spacing_m, self._segmenter, color=self._config.color,
            kept=_CLOUDS_KEPT, followed=_FOLLOWED_KEPT,
        )  # fmt: skip
        observe = self._eyes.observe
        first, gap_m = checked_initial_state(
            recording, observe(frame), self._config.initial_state, segmenter=self._segmenter,
            device=device, force=self._force,
        )  # fmt: skip
        components = Components(
            recording, first.mesh, self._config, observe, first.positions, device
        )
        made = METHODS[self._config.mode](components)
        recorder = Recorder(
            recording, first.mesh, made.state, components.visible, on_disk=True,
            watch=None if self._watch is None else self._show,
        )  # fmt: skip
        return LiveParts(
            components, recorder.timed(made.method), made.state, made.theta, recorder,
            LiveJudge(first.mesh, device), gap_m, first.origin,
        )  # fmt: skip

    def _show(
        self, recording: Recording, mesh: ClothMesh, frame: Frame, positions: np.ndarray
    ) -> None:
        """Call the watcher with a mesh, unless the picture was dropped."""
        if self._watch is not None and frame.depth:
            self._watch(recording, mesh, frame, positions)

    def _turn(self, frame: Frame, closed: set[str]) -> tuple[bool, bool]:
        """Return whether an action begins and whether one ends with a frame.

        The recording is updated before the frame is observed, because followed points are chosen at
        the beginning of actions, and lost ones are searched at the end.
        """
        closing = bool(closed - self._closed_before)
        action = self._action
        if action is not None and action.let_go and closing:
            # A picker closes again before the cloth has settled.
            self._end(action, action.tracked.frame)
            self._finish(wait=True)
            action = None
        begins = self._begins or (closing and action is None)
        ends = action is not None and (action.is_over(frame, closed) or self._ends or self._begins)
        if action is not None and ends:
            action.announce_last(frame.index)
        if begins:
            self._growing.begin_action(frame.index)
        return begins, ends

    def _track(
        self, frame: Frame, parts: LiveParts, closed: set[str], *, begins: bool, ends: bool
    ) -> Observation | None:
        """Track the mesh into a frame; return its cloud, or None if no cloth is found."""
        action = self._action
        self._growing.show_paths(frame.index if action is None else action.first.index)
        self._spent_s = {}
        self._eyes.begin(frame)
        try:
            if action is not None:
                action.grasp(frame, closed)
                action.step(frame)
                self._spent_s |= action.notes.spent_s(frame)
            seen = self._eyes.observe(frame)
            if action is not None:
                action.note_seen(frame, seen)
            self._spent_s["observe"] = self._eyes.spent_s
        except InvalidRecordingError as error:
            # Keep the mesh, and postpone beginnings and ends.
            self._notes.append(str(error))
            if begins:
                self._growing.drop_action(-1)
            if action is not None:
                action.announce_last(None)
                action.stay(frame)
            return None
        if action is not None and ends:
            self._end(action, frame)
        if begins:
            self._begin(parts, frame, closed, seen)
        self._closed_before = closed
        return seen

    def _begin(self, parts: LiveParts, first: Frame, closed: set[str], seen: Observation) -> None:
        """Begin an action with a frame, from the end state of the previous one."""
        self._finish(wait=True)
        by_gripper, self._begins, self._ends = not self._begins, False, False
        self._growing.show_paths(first.index)
        self._action = LiveAction(self._growing, parts, first, by_gripper=by_gripper)
        self._action.note_seen(first, seen)
        self._action.grasp(first, closed)

    def _end(self, action: LiveAction, last: Frame) -> None:
        """End an action with a frame; its final alignment runs in parallel with the stream."""
        assert self._parts is not None
        self._parts.state = action.tracked.state
        self._over, self._action, self._ends = (action, last), None, False

    def _finish(self, *, wait: bool) -> None:
        """Apply the final alignment of the ended action if it is ready."""
        if self._over is None or not (wait or (self._final and self._final.done())):
            return
        (action, last), final, parts = self._over, self._final, self._parts
        self._over = self._final = None
        ended = action.end(last) if final is None else final.result()
        if parts is not None and ended is not None:
            before = parts.state.positions[0]
            parts.theta, parts.state = ended
            parts.judge.end_action(before, parts.state.positions[0])
            self._lags.append(self._finisher.submit(action.picker_lag))

    def _compare_clocks(self, *, wait: bool) -> None:
        """Apply the clock lags measured in ended actions; with `wait`, all of them."""
        while self._lags and (wait or self._lags[0].done()):
            before, self._lag = self._lag, self._lags.pop(0).result()
            if self._lag is not None and before is None:
                lag_s = self._lag.lag_s
                order, size = ("before", "smaller") if lag_s < 0 else ("after", "larger")
                self._notes.append(
                    f"the cloth moves {abs(lag_s):.2f} s {order} the closed picker does: give the "
                    f"picker times that are {size} by so much (`move_picker`)"
                )

    def _state(
        self, frame: Frame, parts: LiveParts, seen: Observation | None, began_s: float
    ) -> LiveState:
        """Return the state of the cloth in a frame."""
        components, action = parts.components, self._action
        state = parts.state if action is None else action.tracked.state
        positions = np.array(state.positions[0], np.float32)
        if action is None:
            self._show(components.recording, components.mesh, frame, positions)
        if seen is not None:
            parts.judge.look(frame.time_s, positions, seen)
        judged, notes = parts.judge.latest, tuple(self._notes)
        self._notes.clear()
        if self._seen_from is None or not np.array_equal(self._seen_from[0], positions):
            self._seen_from = positions, components.visible(positions)
        return LiveState(
            time_s=frame.time_s + self._growing.zero_s,
            frame=frame.index,
            positions=positions,
            visible=self._seen_from[1],
            expected_error_m=judged.expected_error_m,
            lost=judged.lost,
            judged_s=judged.time_s + self._growing.zero_s,
            acting=action is not None,
            settling=self._over is not None,
            picker_lag_s=0.0 if self._lag is None else self._lag.lag_s,
            held={} if action is None else action.held.held_vertices,
            latency_s=time.perf_counter() - began_s,
            spent_s=dict(self._spent_s),
            dropped=self._dropped,
            notes=notes,
        )


_WARM_HEIGHT_M = 0.5
_WARM_RESTING_M = 0.0015


@cache
def _warm_up(mode: ModeName, color: bool, device: str) -> None:
    """Track a lifted towel corner with every step of a mode, once per process."""
    towel = garment("towel", vertex_count=150, size_m=(0.15, 0.15))
    vertices = towel.vertices + (0.0, 0.0, _WARM_RESTING_M - towel.vertices[:, 2].min())
    towel = towel.with_vertices(vertices - np.append(vertices[:, :2].mean(axis=0), 0.0))
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = _WARM_HEIGHT_M
    camera = Camera("warm_up", 160, 120, 150.0, 150.0, 79.5, 59.5, pose)
    drawn = Rasterizer(towel.faces, camera, device=device).render(towel.vertices)
    mask = drawn.faces >= 0
    depth = np.where(mask, drawn.depth, _WARM_HEIGHT_M).astype(np.float32)
    noise = np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    tracker = LiveTracker(
        ClothDescription("towel", template=towel), camera,
        table=Table(np.zeros(3), np.array([0.0, 0.0, 1.0])), device=device, force=True, warm=False,
        config=replace(
            settings_of_mode(mode), color=color, initial_state=InitialStateConfig()
        ),
    )  # fmt: skip
    corner = towel.vertices[np.argmax(towel.vertices[:, :2].sum(axis=1))]
    for step in range(4):
        tip = corner + (-0.005 * step, -0.005 * step, 0.005 * step)
        if step == 3:
            tracker.end_action()
        tracker.update(0.05 * step, depth, noise, mask, {"tip": (tip, 0 < step < 3)})
    tracker.tracked()
