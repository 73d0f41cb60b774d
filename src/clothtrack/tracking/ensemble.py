"""Spread and mean of the candidates of a search.

Cloth in contact is chaotic. Candidates that fit the pictures equally well end in folds that differ
by chance, and the mean of their ends is nearer to the truth than the candidate that fits best.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from jaxtyping import Float

from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.state import Attachment
from clothtrack.tracking.final_alignment import FINAL_STRENGTH, rolled_to
from clothtrack.tracking.protocols import State, TrackedCandidate

SCORE_SCALE = 0.1
"""A candidate whose score exceeds the best score by this fraction of it has weight 1 / e."""

ROLL_S = 0.1
"""Duration of the roll-out to the mean [s]."""


Combine = Callable[
    [TrackedCandidate, Sequence[Float[np.ndarray, "vertices 3"]], Sequence[float]], State
]
"""Return the state that the final alignment starts from.

The arguments are the best candidate, the final vertices of each candidate [m], and their scores.
"""


def ensemble_spread(
    ends: Iterable[Float[np.ndarray, "vertices 3"]],
) -> Float[np.ndarray, " all_or_none"]:
    """Return the mean distance of each vertex from its mean over several final meshes [m].

    Meshes that are not finite are left out; the result is empty if fewer than two remain.
    """
    sound = [end.astype(np.float64) for end in ends if np.isfinite(end).all()]
    if len(sound) < 2:
        return np.zeros(0)
    return np.linalg.norm(sound - np.mean(sound, axis=0), axis=2).mean(axis=0)


def mean_end(
    ends: Sequence[Float[np.ndarray, "vertices 3"]], scores: Sequence[float]
) -> Float[np.ndarray, "all_or_none 3"]:
    """Return the mean of several final meshes [m], weighted by how well each fits."""
    sound = [number for number, score in enumerate(scores) if np.isfinite(score)]
    if len(sound) < 2:
        return np.zeros((0, 3))
    worse = np.array([scores[number] for number in sound])
    worse = worse / max(float(worse.min()), 1e-9) - 1.0
    weights = np.exp(-worse / SCORE_SCALE)
    stacked = np.stack([ends[number].astype(np.float64) for number in sound])
    return np.tensordot(weights / weights.sum(), stacked, axes=1)


class MeanOfCandidates:
    """Roll-out of the best candidate to the mean of all candidates."""

    def __init__(self, dynamics: ClothDynamics, name: str) -> None:
        """Store the dynamics, and the recording's name for messages."""
        self._dynamics, self._name = dynamics, name

    def __call__(
        self,
        best: TrackedCandidate,
        ends: Sequence[Float[np.ndarray, "vertices 3"]],
        scores: Sequence[float],
    ) -> State:
        """Return the cloth at rest at the mean, or the best candidate's state if there is none."""
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
