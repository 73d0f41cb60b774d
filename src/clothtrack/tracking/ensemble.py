"""The candidates of a search as an ensemble: their spread, and their mean.

Cloth in contact is chaotic. Candidates that fit the pictures alike end in folds that differ by
chance, and the mean of their ends is nearer to the truth than the one that fits best.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from jaxtyping import Float

from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.state import Attachment
from clothtrack.tracking.final_alignment import FINAL_STRENGTH, rolled_to
from clothtrack.tracking.protocols import State, TrackedCandidate

SCORE_SCALE = 0.1
"""A candidate whose score is worse than the best by this share of it weighs 1 / e."""

ROLL_S = 0.1
"""Time in which the dynamics take the cloth to the mean [s]."""


Combine = Callable[
    [TrackedCandidate, Sequence[Float[np.ndarray, "vertices 3"]], Sequence[float]], State
]
"""Return the state that the final alignment starts from.

The arguments are the best candidate, where each candidate ends [m], and their scores.
"""


def ensemble_spread(
    ends: Iterable[Float[np.ndarray, "vertices 3"]],
) -> Float[np.ndarray, " all_or_none"]:
    """Return the mean distance of each vertex from its mean over several ends [m].

    Ends that are not finite are left out; the result is empty when fewer than two are left.
    """
    sound = [end.astype(np.float64) for end in ends if np.isfinite(end).all()]
    if len(sound) < 2:
        return np.zeros(0)
    return np.linalg.norm(sound - np.mean(sound, axis=0), axis=2).mean(axis=0)


def mean_end(
    ends: Sequence[Float[np.ndarray, "vertices 3"]], scores: Sequence[float]
) -> Float[np.ndarray, "all_or_none 3"]:
    """Return the mean of several ends [m], weighted by how well each fits.

    Args:
        ends: vertices at the last frame.
        scores: of each end, lower is better, above 0; one that is not finite weighs nothing.

    Returns:
        The mean; empty when fewer than two ends weigh anything.
    """
    sound = [number for number, score in enumerate(scores) if np.isfinite(score)]
    if len(sound) < 2:
        return np.zeros((0, 3))
    worse = np.array([scores[number] for number in sound])
    worse = worse / max(float(worse.min()), 1e-9) - 1.0
    weights = np.exp(-worse / SCORE_SCALE)
    stacked = np.stack([ends[number].astype(np.float64) for number in sound])
    return np.tensordot(weights / weights.sum(), stacked, axes=1)


class MeanOfCandidates:
    """Roll the best candidate to the mean of all candidates."""

    def __init__(self, dynamics: ClothDynamics, name: str) -> None:
        """Take what rolls the cloth there, and the recording's name for messages."""
        self._dynamics, self._name = dynamics, name

    def __call__(
        self,
        best: TrackedCandidate,
        ends: Sequence[Float[np.ndarray, "vertices 3"]],
        scores: Sequence[float],
    ) -> State:
        """Return the cloth at rest at the mean; the best candidate's state without a mean."""
        target = mean_end(ends, scores)
        if not len(target):
            return best.state
        solver = self._dynamics.solver
        solver.set_parameters(best.candidate.theta.cloth_parameters(solver.mesh))
        strength = np.full((1, len(target)), FINAL_STRENGTH, np.float32)
        pull = Attachment(target[None].astype(np.float32), strength)
        return rolled_to(self._dynamics, best.state, pull, ROLL_S, self._name)


def best_candidate(
    best: TrackedCandidate,
    ends: Sequence[Float[np.ndarray, "vertices 3"]],  # noqa: ARG001
    scores: Sequence[float],  # noqa: ARG001
) -> State:
    """Return the end of the best candidate as it is, as in the paper."""
    return best.state
