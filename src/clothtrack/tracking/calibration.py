"""Calibrate theta action by action: the properties of the cloth, and what the picker holds.

`Uncalibrated` yields theta as it is. `OpenLoopCalibration` is the paper's: candidates are rolled
out without any correction and compared with the last cloud, and the best one is tracked (paper,
Sec. III-B.1). `TrackingCalibration` is ours: every candidate is tracked with corrections to the
end of the action and scored by its outline. Its scores follow the true error far better.
"""

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from clothtrack.alignment.silhouette import silhouette_gap
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import PickAndPlace, Recording
from clothtrack.tracking.ensemble import Combine, best_candidate, ensemble_spread
from clothtrack.tracking.open_loop import OpenLoopScore
from clothtrack.tracking.picking import HeldCloth
from clothtrack.tracking.protocols import (
    Candidate,
    Grasps,
    Observe,
    Search,
    State,
    TrackedCandidate,
)
from clothtrack.tracking.search import (
    Axes,
    Proposal,
    Scores,
    SearchConfig,
    Values,
    coordinate_descent,
    grid,
)
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.tracked_trajectory import Calibration

logger = logging.getLogger(__name__)

MIN_IMPROVEMENT = 0.1
"""The search moves to another candidate only if its score is lower by this fraction."""

SCORED_FRAMES = 3
"""Number of frames at which the outline is compared, evenly spaced and ending with the last."""

Pick = Callable[[PickAndPlace, State, Theta], Grasps]
"""Return what the pickers grasp, given the cloth at the start of the action."""


class _OneCandidate:
    """A search whose candidate is chosen before anything is tracked.

    Attributes:
        calibration: the record of how the candidate was found.
    """

    def __init__(self, candidate: Candidate, calibration: Calibration) -> None:
        """Store the candidate, and the record of how it was found."""
        self._candidate, self.calibration = candidate, calibration
        self._tracked: TrackedCandidate | None = None

    def __iter__(self) -> Iterator[Candidate]:
        """Yield the candidate."""
        yield self._candidate

    def tell(self, tracked: TrackedCandidate) -> None:
        """Store the tracked candidate."""
        self._tracked = tracked

    def result(self) -> tuple[TrackedCandidate, State, Calibration]:
        """Return the tracked candidate, its final state, and the record."""
        assert self._tracked is not None
        return self._tracked, self._tracked.state, self.calibration


@dataclass(frozen=True, eq=False)
class Uncalibrated:
    """No calibration: theta stays as it is."""

    pick: Pick

    def __call__(self, action: PickAndPlace, state: State, theta: Theta) -> Search:
        """Return a search that yields theta alone."""
        return _OneCandidate(Candidate(theta, self.pick(action, state, theta)), Calibration.none())


@dataclass(frozen=True, eq=False)
class OpenLoopCalibration:
    """The paper's calibration.

    Attributes:
        propose: proposes candidates from the axes and the previous action's theta; by default
            grid or coordinate descent, according to the configuration.
    """

    pick: Callable[[PickAndPlace, State, Theta], HeldCloth]
    config: SearchConfig
    score: OpenLoopScore
    propose: Callable[[Axes, Theta], Proposal] | None = None

    def __call__(self, action: PickAndPlace, state: State, theta: Theta) -> Search:
        """Search the parameters of an action; return a search that yields only the best one."""
        held = self.pick(action, state, theta)
        axes = self.config.axes
        if not axes or not _moves(held):
            return Uncalibrated(self.pick)(action, state, theta)
        scores = Scores(axes)
        if self.propose is not None:
            proposal = self.propose(axes, theta)
        elif self.config.method == "grid":
            proposal = grid(axes)
        else:
            proposal = coordinate_descent(axes, theta, sweeps=self.config.sweeps)
        asked = next(proposal)
        while True:
            missing = scores.missing(asked)
            thetas = [scores.theta(theta, values) for values in missing]
            for values, score in zip(missing, self.score(state, action, held, thetas), strict=True):
                scores.add(values, score)
            try:
                asked = proposal.send([scores[values] for values in asked])
            except StopIteration as end:
                chosen: Values = end.value
                break
        found = scores.theta(theta, chosen)
        logger.info("frames %d-%d: %s", action.first_frame, action.last_frame, found)
        record = scores.record(self.config.method, "open_loop", chosen)
        return _OneCandidate(Candidate(found, self.pick(action, state, found)), record)


@dataclass(frozen=True, eq=False)
class TrackingCalibration:
    """Our calibration: every candidate is tracked.

    Attributes:
        score: returns the misfit of a tracked candidate, at least 0; lower is better.
        combine: returns the state that combines the ends of all candidates.
    """

    pick: Callable[[PickAndPlace, State, Theta], HeldCloth]
    config: SearchConfig
    score: Callable[[TrackedCandidate], float]
    combine: Combine = best_candidate

    def __call__(self, action: PickAndPlace, state: State, theta: Theta) -> Search:
        """Begin the search for the parameters of an action."""
        axes = self.config.axes
        if not axes or not _moves(self.pick(action, state, theta)):
            return Uncalibrated(self.pick)(action, state, theta)
        proposal = coordinate_descent(
            axes, theta, sweeps=self.config.sweeps, stop_score=self.config.stop_score,
            min_improvement=MIN_IMPROVEMENT,
        )  # fmt: skip
        scores = Scores(axes)

        def candidate(values: Values) -> Candidate:
            found = scores.theta(theta, values)
            return Candidate(found, self.pick(action, state, found))

        return _TrackingSearch(self, proposal, scores, candidate)


class _TrackingSearch:
    """The search of one action."""

    def __init__(
        self,
        calibration: TrackingCalibration,
        proposal: Proposal,
        scores: Scores,
        candidate: Callable[[Values], Candidate],
    ) -> None:
        self._calibration, self._proposal = calibration, proposal
        self._scores, self._candidate = scores, candidate
        self._tracked: dict[tuple[object, ...], tuple[TrackedCandidate, float]] = {}
        self._keys: dict[Values, tuple[object, ...]] = {}
        self._chosen: Values = ()

    def __iter__(self) -> Iterator[Candidate]:
        """Yield candidates; one with the grasp and cloth of a tracked one reuses its score."""
        scores = self._scores
        asked = next(self._proposal)
        while True:
            for values in scores.missing(asked):
                candidate = self._candidate(values)
                key = candidate.grasps.identity(candidate.theta)
                if key not in self._tracked:
                    yield candidate
                self._keys[values] = key
                scores.add(values, self._tracked[key][1])
            try:
                asked = self._proposal.send([scores[values] for values in asked])
            except StopIteration as end:
                self._chosen = end.value
                return

    def tell(self, tracked: TrackedCandidate) -> None:
        """Score a tracked candidate."""
        key = tracked.candidate.grasps.identity(tracked.candidate.theta)
        self._tracked[key] = tracked, self._calibration.score(tracked)

    def result(self) -> tuple[TrackedCandidate, State, Calibration]:
        """Return the best candidate, the combined final state, and the record."""
        best, _ = self._tracked[self._keys[self._chosen]]
        tracked, scores = zip(*self._tracked.values(), strict=True)
        ends = [one.positions[-1] for one in tracked]
        logger.info(
            "frames %d-%d: %s of %d candidates",
            best.action.first_frame, best.action.last_frame, best.candidate.theta, len(ends),
        )  # fmt: skip
        state = self._calibration.combine(best, ends, scores)
        record = self._scores.record(
            "descent", "tracking", self._chosen, spread_m=ensemble_spread(ends)
        )
        return best, state, record


def _moves(held: HeldCloth) -> bool:
    """Return whether a picker moves cloth; otherwise a roll-out does not depend on theta."""
    return any(grasp.moves for grasp in held.grasps)


@dataclass(frozen=True, eq=False)
class OutlineGap:
    """Silhouette misfit between a tracked candidate and the pictures (0 to 1).

    It is measured before TTO2, which fits the outline and would hide errors inside it.
    """

    recording: Recording
    mesh: ClothMesh
    observe: Observe
    device: str = "cpu"

    def __call__(self, tracked: TrackedCandidate) -> float:
        """Return the mean of 1 - IoU over `SCORED_FRAMES` frames; infinite if tracking diverged."""
        if not np.isfinite(tracked.positions).all():
            return np.inf
        count = len(tracked.positions)
        frames = self.recording.frames[tracked.action.first_frame + 1 :]
        places = range(count - 1, -1, -max(1, count // SCORED_FRAMES))[:SCORED_FRAMES]
        gaps: list[float] = []
        for place in places:
            vertices: Float[np.ndarray, "vertices 3"] = tracked.positions[place].astype(np.float64)
            seen = self.observe(frames[place])
            gaps.append(silhouette_gap(self.mesh, vertices, seen, device=self.device))
        return float(np.mean(gaps))
