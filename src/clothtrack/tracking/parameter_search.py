"""Find the cloth's parameters and what the picker holds, action by action (Sec. III-B.1)."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from clothtrack.alignment.silhouette import silhouette_gap
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, PickAndPlace, Recording
from clothtrack.simulation.state import ClothState
from clothtrack.tracking.calibration import PARAMETERS, CalibrationConfig, Score, calibrate
from clothtrack.tracking.configuration import TrackerConfig
from clothtrack.tracking.open_loop import OpenLoopScore
from clothtrack.tracking.picking import Grasp, find_grasps
from clothtrack.tracking.tracked_trajectory import Calibration, StepRecords

logger = logging.getLogger(__name__)

Observe = Callable[[Frame], Observation]


@dataclass(frozen=True, eq=False)
class ActionContext:
    """What stays fixed during one action: who holds what, and with which parameters."""

    action: PickAndPlace
    grasps: tuple[Grasp, ...]
    parameters: dict[str, float]


@dataclass(frozen=True, eq=False)
class FollowedAction:
    """One action, followed to its end with one set of parameters.

    Attributes:
        context: who held what, and the parameters.
        positions: vertices [m] at every frame after the action's first; none of them aligned for
            the last time yet.
        state: the cloth after the final alignment.
        losses: objective [m^2] of the final alignment before and after.
        records: what happened at each frame; those outside the action are empty.
    """

    context: ActionContext
    positions: Float[np.ndarray, "frames vertices 3"]
    state: ClothState
    losses: tuple[float, float]
    records: StepRecords


Follow = Callable[[ActionContext], FollowedAction]


class ParameterSearch:
    """Calibrates one action after the other of one recording."""

    def __init__(
        self,
        recording: Recording,
        mesh: ClothMesh,
        config: TrackerConfig,
        observe: Observe,
        visible: VisibilityCheck,
        *,
        device: str = "cpu",
    ) -> None:
        """Take what all actions share; `config.solver` knows the recording's table."""
        self._recording, self._mesh, self._config = recording, mesh, config
        self._observe, self._visible, self._device = observe, visible, device
        self._open_loop: OpenLoopScore | None = None

    def best(
        self,
        state: ClothState,
        action: PickAndPlace,
        parameters: dict[str, float],
        follow: Follow,
    ) -> tuple[FollowedAction, Calibration]:
        """Follow an action with the parameters that suit it best.

        Judged by tracking, every candidate is followed to the end, corrections and all; judged
        open loop, as in the paper, only the best one is.

        Args:
            state: the cloth at the action's first frame.
            action: the pick-and-place.
            parameters: where the search starts: what the last action was followed with.
            follow: tracks the action from that state.
        """
        context = self._context(state, action, parameters)
        config = self._calibration(context)
        tried = _Tried(lambda chosen: self._context(state, action, chosen), follow)

        def tracked(rows: Float[np.ndarray, "candidates parameters"], _: float) -> np.ndarray:
            return np.array([self._outline_gap(tried[row]) for row in rows.tolist()])

        by_tracking = config.judge == "tracking"
        score = tracked if by_tracking else self._open_loop_score(state, context, config)
        chosen, calibration = calibrate(score, parameters, config)
        followed = tried[[chosen[name] for name in PARAMETERS]]
        logger.info(
            "%s, frames %d-%d: %s after %.1f roll-outs",
            self._recording.name, action.first_frame, action.last_frame,
            {name: chosen[name] for name in calibration.names}, calibration.roll_outs,
        )  # fmt: skip
        return followed, calibration

    def _context(
        self, state: ClothState, action: PickAndPlace, parameters: dict[str, float]
    ) -> ActionContext:
        cloth = self._mesh.with_vertices(state.positions[0].astype(np.float64))
        layers = int(parameters["held_layers"])
        grasps = find_grasps(self._recording, action, cloth, self._config.picking, layers)
        return ActionContext(action, grasps, parameters)

    def _calibration(self, context: ActionContext) -> CalibrationConfig:
        """What this recording and this action leave to be searched."""
        config = self._config.calibration.with_grasp_offset(
            self._recording.cloth.grasp_uncertainty_m
        )
        action = context.action
        too_short = action.last_frame - action.first_frame < self._config.score_frames
        still = not any(grasp.moves for grasp in context.grasps)
        if not self._config.use_action or still or too_short:
            # A roll-out in which nothing is moved says nothing about the cloth, and fewer clouds
            # than are to be compared do not tell one parameter from another.
            return replace(config, method="none")
        return config

    def _open_loop_score(
        self, state: ClothState, context: ActionContext, config: CalibrationConfig
    ) -> Score | None:
        if config.method == "none":
            return None
        if self._open_loop is None:
            self._open_loop = OpenLoopScore(
                self._recording, self._mesh, replace(self._config, calibration=config),
                self._observe, self._visible, device=self._device,
            )  # fmt: skip
        return self._open_loop.of(state, context.action, context.grasps)

    def _outline_gap(self, followed: FollowedAction) -> float:
        """How badly the tracked mesh covers the cloth in the pictures of an action (0 to 1).

        Before the final alignment, which would hide at the outline what is wrong inside.
        """
        if not np.isfinite(followed.positions).all():
            return np.inf
        count, scored = len(followed.positions), self._config.score_frames
        frames = self._recording.frames[followed.context.action.first_frame + 1 :]
        gaps = [
            silhouette_gap(
                self._mesh, followed.positions[place].astype(np.float64),
                self._observe(frames[place]), device=self._device,
            )
            for place in range(count - 1, -1, -max(1, count // scored))[:scored]
        ]  # fmt: skip
        return float(np.mean(gaps))


class _Tried:
    """Candidates that have been followed; those that come to the same are followed once."""

    def __init__(
        self, context: Callable[[dict[str, float]], ActionContext], follow: Follow
    ) -> None:
        self._context, self._follow = context, follow
        self._followed: dict[tuple[object, ...], FollowedAction] = {}

    def __getitem__(self, row: Sequence[float]) -> FollowedAction:
        """The action, followed with this value of each of PARAMETERS."""
        context = self._context(dict(zip(PARAMETERS, row, strict=True)))
        # Where one layer lies under the tip, there is no second one to hold.
        others = {**context.parameters, "held_layers": 0.0}
        held = tuple(tuple(grasp.vertices.tolist()) for grasp in context.grasps)
        key = (held, *others.values())
        if key not in self._followed:
            self._followed[key] = self._follow(context)
        return self._followed[key]
