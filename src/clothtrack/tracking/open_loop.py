"""Score cloth parameters by rolling an action out without any correction (Sec. III-B.1)."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from clothtrack.alignment.cloud_distance import masked_chamfer
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, PickAndPlace, Recording
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import ClothState
from clothtrack.tracking.calibration import BATCH, Score
from clothtrack.tracking.configuration import TrackerConfig
from clothtrack.tracking.picking import Grasp, held_motion
from clothtrack.tracking.theta import PARAMETERS, cloth_parameters, grasp_offset


class OpenLoopScore:
    """Rolls batches of candidates through an action; the solvers are built once per width.

    Environments do not influence each other, so the width of a batch changes no score. A GPU rolls
    a wide batch in the time of a narrow one and keeps one solver; a CPU pays for every environment.
    """

    def __init__(
        self,
        recording: Recording,
        mesh: ClothMesh,
        config: TrackerConfig,
        observe: Callable[[Frame], Observation],
        visible: VisibilityCheck,
        *,
        device: str = "cpu",
    ) -> None:
        """Take what all roll-outs share; solvers are built when they are first needed."""
        widest = max(len(values) for values in config.calibration.axes.values())
        if config.calibration.method != "descent":
            widest = min(BATCH, config.calibration.size)
        self._widest, self._device = widest, device
        self._mesh, self._solver_config, self._config = mesh, config.solver, config.dynamics
        self._dynamics: dict[int, ClothDynamics] = {}
        self._recording, self._observe, self._visible = recording, observe, visible
        self._score_frames = config.score_frames

    def of(self, state: ClothState, action: PickAndPlace, grasps: tuple[Grasp, ...]) -> Score:
        """The score of candidates for this action, started from this state."""

        def score(candidates: Float[np.ndarray, "candidates parameters"], share: float):
            last = action.first_frame + max(
                1, round(share * (action.last_frame - action.first_frame))
            )
            parts = [
                self._roll(candidates[i : i + self._widest], state, action, last, grasps)
                for i in range(0, len(candidates), self._widest)
            ]
            return np.concatenate(parts)

        return score

    def _roll(
        self,
        candidates: Float[np.ndarray, "candidates parameters"],
        state: ClothState,
        action: PickAndPlace,
        last_frame: int,
        grasps: tuple[Grasp, ...],
    ) -> Float[np.ndarray, " candidates"]:
        count = len(candidates)
        dynamics = self._dynamics_of(count)
        rows = candidates[np.minimum(np.arange(dynamics.solver.environments), count - 1)]
        values = [dict(zip(PARAMETERS, row.tolist(), strict=True)) for row in rows]
        dynamics.solver.set_parameters([cloth_parameters(each, self._mesh) for each in values])
        offsets = np.stack([grasp_offset(each) for each in values])
        steps = max(1, (last_frame - action.first_frame) // self._score_frames)
        scored = range(last_frame, action.first_frame, -steps)[: self._score_frames]
        total = np.zeros(count)
        frames = self._recording.frames
        rolled = None
        for frame in frames[action.first_frame + 1 : last_frame + 1]:
            start_s = frames[frame.index - 1].time_s
            motion = held_motion(grasps, start_s, frame.time_s, offsets)
            rolled = dynamics.roll_out(
                state if rolled is None else None, motion, frame.time_s - start_s
            )
            if frame.index in scored:
                observation = self._observe(frame)
                total += [self._chamfer(each, observation) for each in rolled.positions[:count]]
        return total / len(scored)

    def _dynamics_of(self, candidates: int) -> ClothDynamics:
        """Dynamics with room for so many candidates."""
        width = candidates if self._device == "cpu" else self._widest
        if width not in self._dynamics:
            solver = ClothSolver(
                self._mesh, self._solver_config, environments=width, device=self._device
            )
            self._dynamics[width] = ClothDynamics(solver, self._config)
        return self._dynamics[width]

    def _chamfer(
        self, positions: Float[np.ndarray, "vertices 3"], observation: Observation
    ) -> float:
        if not np.isfinite(positions).all():
            return np.inf
        return masked_chamfer(positions, self._visible(positions), observation)
