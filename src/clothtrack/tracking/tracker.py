"""Algorithm 1: the full mesh at every observation, from the dynamics and the cloud together.

Per pick-and-place the cloth's parameters are calibrated; then, frame by frame, the dynamics
predict, test-time optimisation corrects, and the dynamics run again with the correction as a
pseudo-action. At the end of the action the mesh is aligned once more. Nothing here can see the
truth: the only inputs are a recording and a first mesh.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from clothtrack.alignment.aligner import Aligner, Alignment
from clothtrack.alignment.silhouette import slide_to_outline
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import crossing_edges
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.reconstruction.refinement import SETTLE_IN_S
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.simulation.dynamics import ClothDynamics, HeldMotion, RollOut
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import Attachment, ClothState
from clothtrack.tracking.configuration import TrackerConfig
from clothtrack.tracking.line_search import LineSearchResult, search_line
from clothtrack.tracking.open_loop import cloth_parameters, grasp_offset, within_reach
from clothtrack.tracking.parameter_search import (
    ActionContext,
    FollowedAction,
    Observe,
    ParameterSearch,
)
from clothtrack.tracking.picking import held_motion, picker_speed
from clothtrack.tracking.tracked_trajectory import StepRecords, TrackedAction, TrackedTrajectory

logger = logging.getLogger(__name__)

Progress = Callable[[str, int, int], None]


class Tracker:
    """Tracks one cloth through one recording; the solver and its buffers are built once."""

    def __init__(
        self,
        recording: Recording,
        first_mesh: ClothMesh,
        config: TrackerConfig,
        observe: Observe,
        *,
        start: Float[np.ndarray, "vertices 3"] | None = None,
        device: str = "cpu",
    ) -> None:
        """Set up the dynamics, the aligners and the cameras.

        Args:
            recording: what was recorded.
            first_mesh: the flat cloth in the world [m]; its edges are the rest lengths for good.
            config: the whole configuration.
            observe: turns a frame into a cloud.
            start: where its vertices are at the first frame [m], when the cloth does not lie flat
                there.
            device: "cpu" or "cuda:0".
        """
        self._recording, self._mesh, self._config, self._observe = (
            recording, first_mesh, config, observe,
        )  # fmt: skip
        self._solver_config = replace(config.solver, table=recording.table)
        self._device = device
        solver = ClothSolver(first_mesh, self._solver_config, device=device)
        if start is not None:
            # Flat, the layers have a side of each other, and a place to remember it.
            solver.step(SETTLE_IN_S)
            solver.place(start)
            solver.set_velocities(np.zeros_like(start))
        self._dynamics = ClothDynamics(solver, config.dynamics)
        cameras = tuple(camera.resized(config.visibility_width) for camera in recording.cameras)
        self._visible = VisibilityCheck(
            first_mesh.faces, cameras, tolerance_m=config.visibility_tolerance_m, device=device
        )
        self._align = Aligner(first_mesh, config.alignment, device=device)
        self._align_last = Aligner(first_mesh, config.final_alignment, device=device)
        self._search = ParameterSearch(
            recording, first_mesh, replace(config, solver=self._solver_config), observe,
            self._visible, device=device,
        )  # fmt: skip

    def track(self, progress: Progress | None = None) -> TrackedTrajectory:
        """Run Algorithm 1 over every action of the recording."""
        frames = self._recording.frames
        parameters = dict(self._config.parameters)
        state = self._dynamics.solver.save()
        positions = np.repeat(state.positions, len(frames), axis=0)
        records = StepRecords.empty(len(frames))
        actions = []
        for action in self._recording.actions:

            def follow(context: ActionContext, start: ClothState = state) -> FollowedAction:
                return self._follow(start, context, progress)

            followed, calibration = self._search.best(state, action, parameters, follow)
            context, state = followed.context, followed.state
            parameters = context.parameters
            within = slice(action.first_frame + 1, action.last_frame + 1)
            positions[within] = followed.positions
            positions[action.last_frame :] = state.positions[0]
            records.adopt(followed.records, within)
            actions.append(
                TrackedAction(
                    first_frame=action.first_frame,
                    last_frame=action.last_frame,
                    positions_before_final_alignment=followed.positions[-1],
                    positions_after_final_alignment=state.positions[0],
                    final_alignment_losses=np.array(followed.losses),
                    parameters=parameters,
                    calibration=calibration,
                    held_vertices={g.picker: tuple(g.vertices.tolist()) for g in context.grasps},
                )
            )
        return TrackedTrajectory(
            name=self._recording.name,
            mesh=self._mesh,
            frames=np.array([frame.index for frame in frames]),
            time_s=np.array([frame.time_s for frame in frames]),
            positions=positions,
            visible=np.stack([self._visible(each) for each in positions]),
            actions=tuple(actions),
            steps=records,
        )

    def _follow(
        self, state: ClothState, context: ActionContext, progress: Progress | None
    ) -> FollowedAction:
        """Algorithm 1's inner loop over one action, and its final alignment."""
        frames, action = self._recording.frames, context.action
        self._dynamics.solver.set_parameters(cloth_parameters(context.parameters))
        records = StepRecords.empty(len(frames))
        positions = np.repeat(state.positions, action.last_frame - action.first_frame, axis=0)
        for frame in frames[action.first_frame + 1 : action.last_frame + 1]:
            state = self._step(state, context, frame, records)
            positions[frame.index - action.first_frame - 1] = state.positions[0]
            if progress is not None:
                progress(self._recording.name, frame.index + 1, len(frames))
        last = frames[action.last_frame]
        if self._config.use_final_alignment and self._config.final_slide:
            state = self._slid(state, context, last)
        state, losses = self._final_alignment(state, last)
        return FollowedAction(context, positions, state, losses, records)

    def _step(
        self, state: ClothState, context: ActionContext, frame: Frame, records: StepRecords
    ) -> ClothState:
        """One pass of Algorithm 1's inner loop: predict, align, roll again with the correction."""
        start_s = self._recording.frames[frame.index - 1].time_s
        duration_s = frame.time_s - start_s
        motion = None
        if self._config.use_action:
            offset = grasp_offset(context.parameters)
            motion = held_motion(context.grasps, start_s, frame.time_s, offset)

        clock = time.process_time()
        prediction = self._dynamics.roll_out(state, motion, duration_s)
        records.predict_s[frame.index] = time.process_time() - clock
        records.highest_speed[frame.index] = prediction.highest_speed.max()
        if not self._config.use_pseudo_action:
            return prediction.state

        clock = time.process_time()
        observation = self._observe(frame)
        initial = prediction if self._config.use_dynamics_initialisation else state
        aligned = self._alignment(self._align, initial.positions[0], observation)
        records.align_s[frame.index] = time.process_time() - clock
        if aligned is None:
            return prediction.state
        alignment, attached = aligned
        records.loss_before[frame.index] = alignment.losses[0]
        records.loss_after[frame.index] = alignment.losses[-1]

        clock = time.process_time()
        result = self._line_search(
            state, motion, duration_s, prediction, initial.positions[0], alignment, attached,
            picker_speed(context.grasps, start_s, frame.time_s),
        )  # fmt: skip
        records.correct_s[frame.index] = time.process_time() - clock
        records.trials[frame.index] = result.trials
        records.correction_scale[frame.index] = result.scale
        records.gave_up[frame.index] = result.gave_up
        records.highest_speed[frame.index] = result.roll_out.highest_speed.max()
        return result.roll_out.state

    def _at_crossings(
        self, positions: Float[np.ndarray, "vertices 3"]
    ) -> Bool[np.ndarray, " vertices"]:
        """Vertices of the edges and triangles that pass through each other."""
        crossed = np.zeros(len(positions), dtype=bool)
        for part in crossing_edges(positions, self._mesh.faces):
            crossed[part] = True
        return crossed

    def _line_search(  # noqa: PLR0917
        self,
        state: ClothState,
        motion: HeldMotion | None,
        duration_s: float,
        prediction: RollOut,
        initial: Float[np.ndarray, "vertices 3"],
        alignment: Alignment,
        attached: Bool[np.ndarray, " vertices"],
        speed: float,
    ) -> LineSearchResult:
        """Roll the dynamics with the pseudo-action, under the line search."""
        strength = np.where(attached, self._config.attachment_strength, 0.0).astype(np.float32)

        def roll_with_correction(scale: float) -> RollOut:
            pseudo_action = Attachment(
                targets=(initial + scale * alignment.corrections)[None].astype(np.float32),
                strength=strength[None],
            )
            return self._dynamics.roll_out(state, motion, duration_s, pseudo_action)

        search = self._config.line_search
        threshold = search.threshold(speed, float(prediction.highest_speed.max()))
        return search_line(roll_with_correction, prediction, threshold, search)

    def _alignment(
        self, align: Aligner, positions: Float[np.ndarray, "vertices 3"], observation: Observation
    ) -> tuple[Alignment, Bool[np.ndarray, " vertices"]] | None:
        """Align visible vertices to the cloud; None when there is nothing to align to.

        Returns:
            The alignment, and the vertices that a pseudo-action may take hold of.
        """
        visible = self._visible(positions)
        points = within_reach(observation.points, positions[visible], self._config.cloud_reach_m)
        if len(points) < self._config.minimum_observed * len(positions):
            return None
        observed = visible & ~observation.silent(positions)
        alignment = align.align(
            positions,
            points,
            visible,
            trusted=observed,
            table=self._recording.table,
            rest_height_m=self._solver_config.resting_height_m,
        )
        attached = visible
        if self._config.attach_observed_only:
            # Where silence means nothing, a vertex is observed if it found points beside it.
            unsure = np.flatnonzero(visible & ~observed)
            aligned = positions[unsure] + alignment.corrections[unsure]
            attached = observed
            attached[unsure] = self._supported(aligned, points)
        if not self._config.attach_crossed:
            attached = attached & ~self._at_crossings(positions)
        return alignment, attached

    def _supported(
        self,
        vertices: Float[np.ndarray, "vertices 3"],
        points: Float[np.ndarray, "points 3"],
    ) -> Bool[np.ndarray, " vertices"]:
        """Vertices with a cloud point beside them."""
        if not len(vertices):
            return np.zeros(0, dtype=bool)
        tree = cKDTree(points, balanced_tree=False)
        distance = tree.query(vertices, distance_upper_bound=self._config.support_m)[0]
        return np.isfinite(distance)

    def _slid(self, state: ClothState, context: ActionContext, frame: Frame) -> ClothState:
        """The cloth slid over the table as a whole until its outline fits; at rest."""
        table, positions = self._recording.table, state.positions[0]
        held = any(grasp.path.closed_at(frame.time_s) for grasp in context.grasps)
        if table is None or held or not np.isfinite(positions).all():
            return state
        moved = slide_to_outline(
            self._mesh, positions.astype(np.float64), self._observe(frame), table,
            device=self._device,
        )  # fmt: skip
        solver = self._dynamics.solver
        solver.restore(state)
        solver.place(moved)
        solver.set_velocities(np.zeros_like(state.velocities))
        return solver.save()

    def _final_alignment(
        self, state: ClothState, frame: Frame
    ) -> tuple[ClothState, tuple[float, float]]:
        """TTO2: the last word of the cloud on this action's mesh.

        Returns:
            The state that the next action starts from: aligned, at rest, contacts remembered; and
            the objective [m^2] before and after.
        """
        losses = (np.nan, np.nan)
        rounds = self._config.final_rounds if self._config.use_final_alignment else 0
        for _ in range(rounds):
            aligned = self._alignment(self._align_last, state.positions[0], self._observe(frame))
            if aligned is None:
                break
            alignment, attached = aligned
            first = alignment.losses[0] if np.isnan(losses[0]) else losses[0]
            losses = (float(first), float(alignment.losses[-1]))
            state = self._carried_out(state, alignment, attached)
        return state, losses

    def _carried_out(
        self, state: ClothState, alignment: Alignment, attached: Bool[np.ndarray, " vertices"]
    ) -> ClothState:
        """The state after a final alignment: rolled there, or displaced at once; at rest."""
        solver, config = self._dynamics.solver, self._config
        targets = state.positions + alignment.corrections[None]
        if config.final_roll_s > 0.0:
            strength = np.where(attached, config.final_strength, 0.0).astype(np.float32)
            pseudo_action = Attachment(targets.astype(np.float32), strength[None])
            rolled = self._dynamics.roll_out(state, None, config.final_roll_s, pseudo_action)
            if not np.isfinite(rolled.positions).all():
                logger.warning("%s: the final alignment bursts, dropped", self._recording.name)
                solver.restore(state)
        else:
            solver.restore(state)
            solver.place(targets)
        solver.set_velocities(np.zeros_like(state.velocities))
        return solver.save()
