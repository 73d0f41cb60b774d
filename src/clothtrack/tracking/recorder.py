"""Keeps what Algorithm 1 does: positions, losses and CPU times of the passes that are chosen."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from clothtrack.files.progress import Progress
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Frame, PickAndPlace, Recording
from clothtrack.tracking.seams import (
    Corrected,
    Correction,
    FollowedAction,
    Grasps,
    Parts,
    State,
    Theta,
    Watch,
)
from clothtrack.tracking.tracked_trajectory import (
    Calibration,
    StepRecords,
    TrackedAction,
    TrackedTrajectory,
)

Visible = Callable[[Float[np.ndarray, "vertices 3"]], Bool[np.ndarray, " vertices"]]


class Recorder:
    """Collects one trajectory."""

    def __init__(
        self,
        recording: Recording,
        mesh: ClothMesh,
        state: State,
        visible: Visible,
        *,
        progress: Progress | None = None,
        watch: Watch | None = None,
        passes: int = 1,
    ) -> None:
        """Begin a trajectory that stays where it starts.

        Args:
            recording: what is tracked.
            mesh: the flat cloth at rest.
            state: the cloth at the first frame.
            visible: which vertices some camera sees.
            progress: called after every frame.
            watch: is shown the first mesh now, and each that comes.
            passes: passes over an action to reckon with, to tell how much there is to do.
        """
        self._recording, self._mesh, self._visible = recording, mesh, visible
        self._progress, self._most, self._passes = progress, passes, 0
        self._positions = np.repeat(
            np.asarray(state.positions, np.float32), len(recording.frames), axis=0
        )
        self._records = StepRecords.empty(len(recording.frames))
        self._actions: list[TrackedAction] = []
        self._watch = watch
        self._show(recording.frames[0], self._positions[0])

    def begin(self, action: PickAndPlace, parts: Parts) -> "tuple[Pass, Parts]":
        """Begin a pass over an action.

        Returns:
            What notes the pass, and the parts with clocks around them.
        """
        self._passes += 1
        notes = Pass(self._recording, action, self._tell)
        return notes, notes.timed(parts)

    def _show(self, frame: Frame, positions: Float[np.ndarray, "vertices 3"]) -> None:
        if self._watch is not None:
            self._watch(self._recording, self._mesh, frame, positions)

    def _tell(
        self, action: PickAndPlace, frame: Frame, positions: Float[np.ndarray, "vertices 3"]
    ) -> None:
        """Show the mesh, and tell which frame of which candidate of which action is done."""
        self._show(frame, positions)
        if self._progress is None:
            return
        spans = [one.last_frame - one.first_frame for one in self._recording.actions]
        number, most, tried = len(self._actions), self._most, self._passes
        place, span = frame.index - action.first_frame, spans[number]
        # A search that goes on after what was reckoned with waits there: no share steps back, and
        # none is whole before the last candidate is.
        within = min((tried - 1) * span + place, most * span - (most > 1))
        of = f"/{most}" if tried <= most else ""
        candidate = f", candidate {tried}{of}" if max(tried, most) > 1 else ""
        self._progress(
            f"{self._recording.name}: action {number + 1}/{len(spans)}{candidate}, "
            f"frame {place}/{span}",
            most * sum(spans[:number]) + within,
            most * sum(spans),
        )

    def keep(
        self,
        followed: FollowedAction,
        state: State,
        losses: tuple[float, float],
        calibration: Calibration,
    ) -> None:
        """Keep the pass that was chosen, with its final alignment.

        Args:
            followed: the pass.
            state: the cloth after TTO2; the frames that follow start from there.
            losses: objective of TTO2 [m^2], before and after.
            calibration: the candidates that were tried.
        """
        action = followed.action
        within = slice(action.first_frame + 1, action.last_frame + 1)
        end = np.asarray(state.positions[0], np.float32)
        self._positions[within] = followed.positions
        self._positions[action.last_frame :] = end
        self._show(self._recording.frames[action.last_frame], end)
        self._records.adopt(followed.records, within)
        self._passes = 0
        self._actions.append(
            TrackedAction(
                first_frame=action.first_frame,
                last_frame=action.last_frame,
                positions_before_final_alignment=followed.positions[-1],
                positions_after_final_alignment=end,
                final_alignment_losses=np.array(losses),
                parameters=dict(followed.theta),
                calibration=calibration,
                held_vertices=followed.grasps.held_vertices,
            )
        )

    def trajectory(self) -> TrackedTrajectory:
        """All that was kept."""
        frames = self._recording.frames
        return TrackedTrajectory(
            name=self._recording.name,
            mesh=self._mesh,
            frames=np.array([frame.index for frame in frames]),
            time_s=np.array([frame.time_s for frame in frames]),
            positions=self._positions,
            visible=np.stack([self._visible(each) for each in self._positions]),
            actions=tuple(self._actions),
            steps=self._records,
        )


class Pass:
    """Notes of one pass over one action."""

    def __init__(
        self,
        recording: Recording,
        action: PickAndPlace,
        tell: Callable[[PickAndPlace, Frame, Float[np.ndarray, "vertices 3"]], None],
    ) -> None:
        """Begin with empty records; `tell` hears of every frame and its mesh."""
        self._action, self._tell = action, tell
        self._records = StepRecords.empty(len(recording.frames))
        self._positions: list[np.ndarray] = []
        self._clocks = dict.fromkeys(("predict_s", "align_s", "correct_s"), 0.0)
        self._running = False

    def timed(self, parts: Parts) -> Parts:
        """The same parts, with clocks around prediction, alignment and line search."""
        return replace(
            parts,
            predict=self._clocked("predict_s", parts.predict),
            align=self._clocked("align_s", parts.align),
            line_search=self._clocked("correct_s", parts.line_search),
        )

    def step(
        self,
        frame: Frame,
        correction: Correction | None,
        corrected: Corrected,
    ) -> None:
        """Note what happened at one frame."""
        records, at = self._records, frame.index
        records.predict_s[at] = self._clocks["predict_s"]
        records.highest_speed[at] = corrected.prediction.highest_speed.max()
        if correction is not None:
            records.align_s[at] = self._clocks["align_s"]
            records.correct_s[at] = self._clocks["correct_s"]
            records.loss_before[at], records.loss_after[at] = correction.losses
            records.trials[at] = corrected.trials
            records.correction_scale[at] = corrected.scale
            records.gave_up[at] = corrected.gave_up
        self._clocks = dict.fromkeys(self._clocks, 0.0)
        self._positions.append(np.asarray(corrected.state.positions[0], np.float32))
        self._tell(self._action, frame, self._positions[-1])

    def finished(self, theta: Theta, grasps: Grasps, state: State) -> FollowedAction:
        """The whole pass, and the cloth that it ends with."""
        return FollowedAction(
            self._action, theta, grasps, np.stack(self._positions), state, self._records
        )

    def _clocked(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, its CPU time added up; calls within a clocked call are that one's."""

        @wraps(call)
        def clocked(*arguments: Any) -> Any:
            if self._running:
                return call(*arguments)
            self._running, clock = True, time.process_time()
            try:
                return call(*arguments)
            finally:
                self._clocks[name] += time.process_time() - clock
                self._running = False

        return clocked
