"""Calibrates theta, action by action: which cloth is this, and what does the picker hold?

`calibration.calibrate` proposes candidates, `open_loop` or the outline of the tracked mesh scores
them (paper, Sec. III-B.1).
"""

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from clothtrack.alignment.silhouette import silhouette_gap
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.recordings.recording import PickAndPlace, Recording
from clothtrack.simulation.state import ClothState
from clothtrack.tracking.calibration import CalibrationConfig, Score, calibrate
from clothtrack.tracking.configuration import TrackerConfig
from clothtrack.tracking.ensemble import ends_apart, mean_end
from clothtrack.tracking.open_loop import OpenLoopScore
from clothtrack.tracking.picking import HeldCloth
from clothtrack.tracking.seams import FollowedAction, Observe, State
from clothtrack.tracking.theta import PARAMETERS, Theta
from clothtrack.tracking.tracked_trajectory import Calibration

logger = logging.getLogger(__name__)

FollowWith = Callable[[Theta], FollowedAction]


class Calibrator:
    """Calibrates one action after the other of one recording."""

    def __init__(
        self,
        recording: Recording,
        mesh: ClothMesh,
        config: TrackerConfig,
        observe: Observe,
        visible: VisibilityCheck,
        *,
        pick: Callable[[PickAndPlace, ClothState, Theta], HeldCloth],
        device: str = "cpu",
    ) -> None:
        """Take what all actions share; `config.solver` knows the recording's table."""
        self._recording, self._mesh, self._config = recording, mesh, config
        self._observe, self._visible, self._device = observe, visible, device
        self._pick = pick
        self._open_loop: OpenLoopScore | None = None

    def __call__(
        self, action: PickAndPlace, state: ClothState, theta: Theta, follow_with: FollowWith
    ) -> tuple[Theta, Calibration]:
        """The theta that suits an action best, and the record of all candidates.

        Judged by tracking, every candidate is followed to the end, corrections and all; judged
        open loop, as in the paper, none is.

        Args:
            action: the pick-and-place.
            state: the cloth at its first frame.
            theta: where the search starts: what the last action was followed with.
            follow_with: tracks the action from that state.
        """
        held = self._pick(action, state, theta)
        config = self._to_search(action, held)
        passes: dict[int, tuple[FollowedAction, float]] = {}

        def tracked(rows: Float[np.ndarray, "candidates parameters"], _: float) -> np.ndarray:
            candidates = [dict(zip(PARAMETERS, row, strict=True)) for row in rows.tolist()]
            followed = [follow_with(each) for each in candidates]
            gaps = [self._outline_gap(each) for each in followed]
            # Candidates that come to the same pass count once.
            passes.update({id(one): (one, gap) for one, gap in zip(followed, gaps, strict=True)})
            return np.array(gaps)

        by_tracking = config.judge == "tracking"
        score = tracked if by_tracking else self._open_loop_score(state, action, held, config)
        chosen, calibration = calibrate(score, theta, config)
        logger.info(
            "%s, frames %d-%d: %s after %.1f roll-outs",
            self._recording.name, action.first_frame, action.last_frame,
            {name: chosen[name] for name in calibration.names}, calibration.roll_outs,
        )  # fmt: skip
        ends = [followed.positions[-1] for followed, _ in passes.values()]
        mean_m = mean_end(ends, [gap for _, gap in passes.values()])
        return chosen, replace(calibration, spread_m=ends_apart(ends), mean_m=mean_m)

    def _to_search(self, action: PickAndPlace, held: HeldCloth) -> CalibrationConfig:
        """What this recording and this action leave to be searched."""
        config = self._config.calibration.with_grasp_offset(
            self._recording.cloth.grasp_uncertainty_m
        )
        still = not any(grasp.moves for grasp in held.grasps)
        frames = action.last_frame - action.first_frame
        too_short = config.judge == "open_loop" and frames < self._config.score_frames
        if still or too_short:
            # A roll-out in which nothing is moved says nothing about the cloth, and fewer clouds
            # than are to be compared do not tell one open-loop roll-out from another.
            return replace(config, method="none")
        return config

    def _open_loop_score(
        self, state: ClothState, action: PickAndPlace, held: HeldCloth, config: CalibrationConfig
    ) -> Score | None:
        if config.method == "none":
            return None
        if self._open_loop is None:
            self._open_loop = OpenLoopScore(
                self._recording, self._mesh, replace(self._config, calibration=config),
                self._observe, self._visible, device=self._device,
            )  # fmt: skip
        return self._open_loop.of(state, action, held.grasps)

    def _outline_gap(self, followed: FollowedAction) -> float:
        """How badly the tracked mesh covers the cloth in the pictures of an action (0 to 1).

        Before the final alignment, which would hide at the outline what is wrong inside.
        """
        if not np.isfinite(followed.positions).all():
            return np.inf
        count, scored = len(followed.positions), self._config.score_frames
        frames = self._recording.frames[followed.action.first_frame + 1 :]
        gaps = [
            silhouette_gap(
                self._mesh, followed.positions[place].astype(np.float64),
                self._observe(frames[place]), device=self._device,
            )
            for place in range(count - 1, -1, -max(1, count // scored))[:scored]
        ]  # fmt: skip
        return float(np.mean(gaps))


def uncalibrated(
    action: PickAndPlace,  # noqa: ARG001
    state: State,  # noqa: ARG001
    theta: Theta,
    follow_with: FollowWith,  # noqa: ARG001
) -> tuple[Theta, Calibration]:
    """Keep theta as it is: nothing is searched."""
    return theta, Calibration.none()
