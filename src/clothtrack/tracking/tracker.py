"""Assembles Algorithm 1: the parts that a configuration names, for one recording and one cloth."""

from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float

from clothtrack.files.progress import Progress
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.reconstruction.refinement import SETTLE_IN_S
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Recording
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.solver import ClothSolver
from clothtrack.tracking.algorithm import track
from clothtrack.tracking.calibrator import Calibrator, uncalibrated
from clothtrack.tracking.configuration import TrackerConfig
from clothtrack.tracking.ensemble import MeanOfCandidates, chosen_candidate
from clothtrack.tracking.final_alignment import FinalAlignment, no_final_alignment
from clothtrack.tracking.line_search import PseudoActionSearch
from clothtrack.tracking.picking import pick, without_motion
from clothtrack.tracking.picture_marks import PictureMarks, no_marks
from clothtrack.tracking.recorder import Recorder
from clothtrack.tracking.seams import Dyn, Observe, Parts, State, Watch, coarse, exact
from clothtrack.tracking.theta import Theta, cloth_parameters
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory
from clothtrack.tracking.visible_alignment import (
    VisibleAlignment,
    from_last_mesh,
    no_alignment,
    only_at,
)

VISIBILITY_WIDTH = 320
"""Width of the z-buffer that decides visibility [pixels]: its pixels are finer than the
mesh's edges."""

VISIBILITY_TOLERANCE_M = 0.003
"""How far behind the z-buffer's surface a vertex still counts as visible [m]: less than
the distance of two layers."""


LEAST_TOLD = 0.5
"""Share of the visible vertices of a first mesh that the cloud must be able to contradict."""


class Tracker:
    """Tracks one cloth through one recording; the solver and its buffers are built once.

    Attributes:
        parts: what the configuration makes of Algorithm 1; `dataclasses.replace` exchanges one.
    """

    def __init__(
        self,
        recording: Recording,
        mesh: ClothMesh,
        config: TrackerConfig,
        observe: Observe,
        *,
        start: Float[np.ndarray, "vertices 3"] | None = None,
        device: str = "cpu",
    ) -> None:
        """Set up the dynamics, the aligners and the cameras.

        Args:
            recording: what was recorded.
            mesh: the flat cloth in the world [m]; its edges are the rest lengths for good.
            config: the whole configuration.
            observe: turns a frame into a cloud.
            start: where its vertices are at the first frame [m], when the cloth does not lie flat
                there.
            device: "cpu" or "cuda:0".
        """
        self._recording, self._mesh, self._theta = recording, mesh, config.parameters
        searched = config.calibration.with_grasp_offset(recording.cloth.grasp_uncertainty_m)
        self._passes = searched.passes if config.use_action else 1
        config = replace(config, solver=replace(config.solver, table=recording.table))
        solver = ClothSolver(mesh, config.solver, device=device)
        if start is not None:
            # Flat, the layers have a side of each other, and a place to remember it.
            solver.step(SETTLE_IN_S)
            solver.place(start)
            solver.set_velocities(np.zeros_like(start))
        state = solver.save()
        cameras = tuple(camera.resized(VISIBILITY_WIDTH) for camera in recording.cameras)
        self._visible = VisibilityCheck(
            mesh.faces, cameras, tolerance_m=VISIBILITY_TOLERANCE_M, device=device
        )
        self.parts = _parts(
            recording, mesh, config, observe, self._visible,
            dynamics=ClothDynamics(solver, config.dynamics), device=device,
        )  # fmt: skip
        if config.align_first_mesh:
            state = self._aligned_first(state, observe(recording.frames[0]))
        self._state = state

    def _aligned_first(self, state: State, observation: Observation) -> State:
        """The cloth at the first frame aligned to its cloud, where this shows most of it."""
        positions, start_s = state.positions[0], self._recording.frames[0].time_s
        visible = self._visible(positions)
        told = visible & ~observation.unobservable(positions.astype(np.float64))
        # Of a cloth below a cut a cloud shows a hand's breadth: the rest would slide after it.
        if told.sum() < LEAST_TOLD * visible.sum():
            return state
        held = any(path.closed_at(start_s) for path in self._recording.picker_paths.values())
        # Whatever is searched or given, a replay with the chosen theta starts alike.
        theta = TrackerConfig().parameters
        return self.parts.align_last(state, theta, observation, held)[0]

    def track(
        self, progress: Progress | None = None, watch: Watch | None = None
    ) -> TrackedTrajectory:
        """Run Algorithm 1 over every action of the recording.

        Args:
            progress: called after every frame with action, candidate and frame; counts the frames
                of all passes that are to be reckoned with.
            watch: is shown every mesh.
        """
        recorder = Recorder(
            self._recording, self._mesh, self._state, self._visible,
            progress=progress, watch=watch, passes=self._passes,
        )  # fmt: skip
        track(self._recording, self._state, dict(self._theta), self.parts, recorder)
        return recorder.trajectory()


def _parts(
    recording: Recording,
    mesh: ClothMesh,
    config: TrackerConfig,
    observe: Observe,
    visible: VisibilityCheck,
    *,
    dynamics: ClothDynamics,
    device: str,
) -> Parts:
    """The paper's method, ours, or an ablation: each is a choice of functions."""
    marks = PictureMarks(mesh, visible)
    average = MeanOfCandidates(dynamics, recording.name)
    aligned = partial(
        VisibleAlignment, mesh, config, visible=visible, table=recording.table, marks=marks,
        device=device,
    )  # fmt: skip
    take_hold = partial(pick, recording=recording, mesh=mesh)
    align_last = no_final_alignment
    if config.use_final_alignment:
        align_last = FinalAlignment(
            recording, mesh, config, aligned(alignment=config.last_alignment), dynamics,
            device=device,
        )  # fmt: skip

    def simulated(theta: Theta) -> Dyn:
        dynamics.solver.set_parameters(cloth_parameters(theta, mesh))
        return dynamics

    # Without a pseudo-action predictions are all there is.
    is_coarse = config.use_pseudo_action and config.dynamics.prediction_coarseness > 1
    align, seen = aligned(alignment=config.alignment), observe
    if not config.use_pseudo_action:
        ends = {action.last_frame for action in recording.actions}
        align, seen = no_alignment, only_at(ends, observe, recording)
    return Parts(
        observe=seen,
        pick=take_hold if config.use_action else without_motion(take_hold),
        calibrate=(
            Calibrator(recording, mesh, config, observe, visible, pick=take_hold, device=device)
            if config.use_action
            else uncalibrated
        ),
        dynamics=simulated,
        predict=coarse if is_coarse else exact,
        align=align if config.use_dynamics_initialisation else from_last_mesh(align),
        line_search=PseudoActionSearch(
            config.line_search, config.attachment_strength, prediction_stands=not is_coarse
        ),
        combine=average if config.average_candidates else chosen_candidate,
        align_last=align_last,
        mark=marks.bind if config.uses_color else no_marks,
    )
