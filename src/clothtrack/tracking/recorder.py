"""Record the positions, losses and CPU times of the chosen candidates of Algorithm 1."""

import io
import tempfile
import time
import weakref
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import wraps
from typing import IO, Any

import numpy as np
from jaxtyping import Bool, Float, Float32

from clothtrack.files.progress import Progress
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Frame, PickAndPlace, Recording
from clothtrack.simulation.picker_action import PickerAction
from clothtrack.simulation.state import Attachment
from clothtrack.tracking.protocols import (
    Candidate,
    Corrected,
    Correction,
    Dynamics,
    Method,
    Prediction,
    State,
    TrackedCandidate,
    Watch,
)
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.tracked_trajectory import (
    Calibration,
    StepRecords,
    TrackedAction,
    TrackedTrajectory,
)

_AT_ONCE = 64
"""Meshes per write when one is repeated, so that an hour of rest needs no large array."""


class MeshLog:
    """Store of meshes; on disk, it needs constant memory for any number of meshes.

    The system chooses the file (`TMPDIR`). It is removed together with this object.
    """

    def __init__(self, vertices: int, *, on_disk: bool = False) -> None:
        """Begin without a mesh."""
        self._shape = (vertices, 3)
        self._on_disk, self._count = on_disk, 0
        self._file: IO[bytes] = io.BytesIO()
        if on_disk:
            self._file = tempfile.TemporaryFile(prefix="clothtrack-")  # noqa: SIM115
        weakref.finalize(self, self._file.close)

    def __len__(self) -> int:
        """Return the number of meshes."""
        return self._count

    def write(self, first: int, meshes: Float32[np.ndarray, "meshes vertices 3"]) -> None:
        """Write meshes [m] from index `first` on; overwrite existing ones or extend the log."""
        values = np.ascontiguousarray(meshes, np.float32)
        self._file.seek(first * self._bytes)
        self._file.write(values.data)
        self._count = max(self._count, first + len(values))

    def append(self, mesh: Float32[np.ndarray, "vertices 3"]) -> None:
        """Append a mesh [m]."""
        self.write(self._count, np.asarray(mesh, np.float32)[None])

    def fill(self, first: int, last: int, mesh: Float32[np.ndarray, "vertices 3"]) -> None:
        """Write the same mesh [m] at all indices from `first` to before `last`."""
        some = np.repeat(np.asarray(mesh, np.float32)[None], min(_AT_ONCE, last - first), axis=0)
        for start in range(first, last, _AT_ONCE):
            self.write(start, some[: last - start])

    def newest(self) -> Float32[np.ndarray, "vertices 3"]:
        """Return the last mesh [m]."""
        self._file.seek((self._count - 1) * self._bytes)
        return np.frombuffer(self._file.read(self._bytes), np.float32).reshape(self._shape)

    def meshes(self) -> Float32[np.ndarray, "meshes vertices 3"]:
        """Return all meshes [m]; those in a file are read when accessed."""
        shape = (self._count, *self._shape)
        if not self._on_disk or not self._count:
            self._file.seek(0)
            return np.frombuffer(bytearray(self._file.read()), np.float32).reshape(shape)
        self._file.flush()
        return np.asarray(np.memmap(self._file, np.float32, mode="c", shape=shape))

    @property
    def _bytes(self) -> int:
        return 12 * self._shape[0]


_ON_DISK = np.zeros((0, 3), np.float32)
"""Placeholder for the meshes of an action until the trajectory is requested."""

Visible = Callable[[Float[np.ndarray, "vertices 3"]], Bool[np.ndarray, " vertices"]]


class Recorder:
    """Recorder of one trajectory."""

    def __init__(
        self,
        recording: Recording,
        mesh: ClothMesh,
        state: State,
        visible: Visible,
        *,
        progress: Progress | None = None,
        watch: Watch | None = None,
        candidates: int = 1,
        on_disk: bool = False,
    ) -> None:
        """Begin a trajectory in which every frame has the first mesh."""
        self._recording, self._mesh, self._visible = recording, mesh, visible
        self._progress, self._expected, self._begun = progress, candidates, 0
        self._on_disk = on_disk
        self._meshes = MeshLog(mesh.vertex_count, on_disk=on_disk)
        self._meshes.write(0, np.asarray(state.positions, np.float32))
        self._records = StepRecords.empty(0)
        self._reach(len(recording.frames))
        self._actions: list[TrackedAction] = []
        # Two meshes per action: before and after its final alignment.
        self._ends = MeshLog(mesh.vertex_count, on_disk=on_disk)
        self._watch, self._clocks = watch, Clocks()
        self._show(recording.frames[0], np.asarray(state.positions[0], np.float32))

    def timed(self, method: Method) -> Method:
        """Return the same method with clocks around prediction, alignment and line search."""
        return self._clocks.around(method)

    def begin(self, action: PickAndPlace, candidate: Candidate) -> "CandidateNotes":
        """Begin the notes of one candidate."""
        self._begun += 1
        log = MeshLog(self._mesh.vertex_count, on_disk=self._on_disk)
        return CandidateNotes(
            self._recording, action, candidate, self._clocks, self._tell, meshes=log
        )

    def _show(self, frame: Frame, positions: Float[np.ndarray, "vertices 3"]) -> None:
        if self._watch is not None:
            self._watch(self._recording, self._mesh, frame, positions)

    def _tell(
        self, action: PickAndPlace, frame: Frame, positions: Float[np.ndarray, "vertices 3"]
    ) -> None:
        """Pass the mesh to `watch`, and report the finished frame, candidate and action."""
        self._show(frame, positions)
        if self._progress is None:
            return
        spans = [one.last_frame - one.first_frame for one in self._recording.actions]
        number, most, tried = len(self._actions), self._expected, self._begun
        place, span = frame.index - action.first_frame, spans[number]
        # If the search exceeds the estimate, hold progress so that it never decreases.
        within = min((tried - 1) * span + place, most * span - (most > 1))
        of = f"/{most}" if tried <= most else ""
        candidate = f", candidate {tried}{of}" if max(tried, most) > 1 else ""
        self._progress(
            f"{self._recording.name}: action {number + 1}/{len(spans)}{candidate}, "
            f"frame {place}/{span}",
            most * sum(spans[:number]) + within,
            most * sum(spans),
        )

    def _reach(self, count: int) -> None:
        """Extend to this many frames with the newest mesh, because a live recording grows."""
        self._meshes.fill(len(self._meshes), count, self._meshes.newest())
        known, self._records = self._records, StepRecords.empty(count)
        self._records.adopt(known, slice(0, len(known.trials)))

    def keep(
        self,
        best: TrackedCandidate,
        state: State,
        losses: tuple[float, float],
        calibration: Calibration,
    ) -> None:
        """Store the chosen candidate of an action with its final alignment.

        Args:
            losses: objective of TTO2 [m^2], before and after.
        """
        self._reach(len(self._recording.frames))
        action = best.action
        within = slice(action.first_frame + 1, action.last_frame + 1)
        end = np.asarray(state.positions[0], np.float32)
        self._meshes.write(within.start, best.positions)
        self._meshes.fill(action.last_frame, len(self._meshes), end)
        self._records.adopt(best.records, within)
        self._ends.write(2 * len(self._actions), np.stack([best.positions[-1], end]))
        kept = TrackedAction(
            first_frame=action.first_frame,
            last_frame=action.last_frame,
            positions_before_final_alignment=_ON_DISK,
            positions_after_final_alignment=_ON_DISK,
            final_alignment_losses=np.array(losses),
            parameters={k: float(v) for k, v in asdict(best.candidate.theta).items()},
            calibration=calibration,
            held_vertices=best.candidate.grasps.held_vertices,
        )
        self._actions.append(kept)
        self._begun = 0
        self._show(self._recording.frames[action.last_frame], end)

    def trajectory(self) -> TrackedTrajectory:
        """Return everything that was stored."""
        frames = self._recording.frames
        self._reach(len(frames))
        positions, ends = self._meshes.meshes(), np.array(self._ends.meshes())
        return TrackedTrajectory(
            name=self._recording.name,
            mesh=self._mesh,
            frames=np.array([frame.index for frame in frames]),
            time_s=np.array([frame.time_s for frame in frames]),
            positions=positions,
            visible=self._seen(positions),
            actions=tuple(
                replace(
                    action,
                    positions_before_final_alignment=before,
                    positions_after_final_alignment=after,
                )
                for action, before, after in zip(self._actions, ends[::2], ends[1::2], strict=True)
            ),
            steps=self._records,
        )

    def _seen(
        self, positions: Float[np.ndarray, "frames vertices 3"]
    ) -> Bool[np.ndarray, "frames vertices"]:
        """Return which vertices some camera sees; check repeated meshes only once."""
        seen = np.zeros(positions.shape[:2], bool)
        for frame, mesh in enumerate(positions):
            rests = frame > 0 and np.array_equal(mesh, positions[frame - 1])
            seen[frame] = seen[frame - 1] if rests else self._visible(mesh)
        return seen


class CandidateNotes:
    """Records of tracking one candidate."""

    def __init__(
        self,
        recording: Recording,
        action: PickAndPlace,
        candidate: Candidate,
        clocks: "Clocks",
        tell: Callable[[PickAndPlace, Frame, Float[np.ndarray, "vertices 3"]], None],
        *,
        meshes: MeshLog,
    ) -> None:
        """Begin with empty records; `tell` is called with every frame and its mesh."""
        self._recording, self._action, self._candidate = recording, action, candidate
        self._clocks, self._tell = clocks, tell
        self._steps: list[tuple[int, dict[str, float | bool]]] = []
        self._meshes = meshes
        clocks.reset()

    def step(
        self,
        frame: Frame,
        correction: Correction | None,
        corrected: Corrected,
    ) -> None:
        """Record one frame."""
        clocks = self._clocks
        step: dict[str, float | bool] = {
            "predict_s": clocks.predict_s,
            "highest_speed": float(corrected.prediction.highest_speed.max()),
        }
        if correction is not None:
            step |= {
                "align_s": clocks.align_s,
                "correct_s": clocks.correct_s,
                "loss_before": correction.losses[0],
                "loss_after": correction.losses[1],
                "trials": corrected.trials,
                "correction_scale": corrected.scale,
                "gave_up": corrected.gave_up,
            }
        self._steps.append((frame.index, step))
        clocks.reset()
        self._note(frame, corrected.state)

    def spent_s(self, frame: Frame) -> dict[str, float]:
        """Return the CPU time of each part of a frame [s], by its name; empty at rest."""
        if not self._steps or self._steps[-1][0] != frame.index:
            return {}
        step = self._steps[-1][1]
        names = {"predict_s": "predict", "align_s": "align", "correct_s": "correct"}
        return {short: float(step[name]) for name, short in names.items() if name in step}

    def rest(self, frame: Frame, state: State) -> None:
        """Record that the mesh stays unchanged at one frame."""
        self._clocks.reset()
        self._note(frame, state)

    def _note(self, frame: Frame, state: State) -> None:
        positions = np.asarray(state.positions[0], np.float32)
        self._meshes.append(positions)
        self._tell(self._action, frame, positions)

    def finished(self, state: State) -> TrackedCandidate:
        """Return the tracked candidate with its final state."""
        records = StepRecords.empty(len(self._recording.frames))
        for at, step in self._steps:
            for name, value in step.items():
                getattr(records, name)[at] = value
        return TrackedCandidate(
            self._action, self._candidate, self._meshes.meshes(), state, records
        )


class Clocks:
    """CPU times [s] since the last reset.

    Attributes:
        predict_s: CPU time of predictions [s].
        align_s: CPU time of TTO1 with its visibility [s].
        correct_s: CPU time of the line search [s].
    """

    def __init__(self) -> None:
        """Begin at 0."""
        self.reset()

    def reset(self) -> None:
        """Set every clock to 0."""
        self.predict_s = self.align_s = self.correct_s = 0.0

    def around(self, method: Method) -> Method:
        """Return the same method with clocks around prediction, alignment and line search."""

        def dynamics(theta: Theta) -> Dynamics:
            dyn = method.dynamics(theta)
            return _TimedDynamics(dyn, self._timed("predict_s", dyn.predict))

        return replace(
            method,
            dynamics=dynamics,
            align=self._timed("align_s", method.align),
            line_search=self._timed("correct_s", method.line_search),
        )

    def _timed(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(call)
        def timed(*arguments: Any) -> Any:
            # Time this thread only: another one may read the next picture meanwhile.
            start = time.thread_time()
            try:
                return call(*arguments)
            finally:
                setattr(self, name, getattr(self, name) + time.thread_time() - start)

        return timed


@dataclass(frozen=True, eq=False)
class _TimedDynamics:
    """Dynamics whose predictions are timed."""

    dynamics: Dynamics
    predict: Callable[..., Prediction]

    def __call__(
        self, state: State, action: PickerAction, pseudo_action: Attachment | None = None
    ) -> Prediction:
        return self.dynamics(state, action, pseudo_action)
