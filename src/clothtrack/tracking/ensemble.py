"""The candidates of a search as an ensemble: where they end apart, and their mean.

Cloth in contact is chaotic. Candidates that fit the pictures alike end in folds that differ by
chance, and the mean of their ends is nearer to the truth than the one that fits best.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.state import Attachment
from clothtrack.tracking.final_alignment import FINAL_STRENGTH, rolled_to
from clothtrack.tracking.seams import State
from clothtrack.tracking.theta import Theta, cloth_parameters
from clothtrack.tracking.tracked_trajectory import Calibration

SCORE_SCALE = 0.1
"""A candidate whose score is worse than the best by this share of it weighs 1 / e."""

ROLL_S = 0.1
"""Time in which the dynamics take the cloth to the mean [s]."""


def ends_apart(
    ends: Iterable[Float[np.ndarray, "vertices 3"]],
) -> Float[np.ndarray, " all_or_none"]:
    """Mean distance of each vertex from its mean over the ends of several passes [m].

    Ends that are not finite are left out; empty when fewer than two are left.
    """
    sound = [end.astype(np.float64) for end in ends if np.isfinite(end).all()]
    if len(sound) < 2:
        return np.zeros(0)
    return np.linalg.norm(sound - np.mean(sound, axis=0), axis=2).mean(axis=0)


def mean_end(
    ends: Sequence[Float[np.ndarray, "vertices 3"]], scores: Sequence[float]
) -> Float[np.ndarray, "all_or_none 3"]:
    """Mean of the ends of several passes [m], weighted by how well each fits.

    Args:
        ends: vertices at the last frame.
        scores: of each pass, lower is better, above 0; one that is not finite weighs nothing.

    Returns:
        The mean; empty when fewer than two passes weigh anything.
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
    """Takes the chosen pass to the mean of all candidates, by the dynamics."""

    def __init__(self, dynamics: ClothDynamics, name: str) -> None:
        """Take what rolls the cloth there, and the recording's name for messages."""
        self._dynamics, self._name = dynamics, name

    def __call__(self, state: State, theta: Theta, calibration: Calibration) -> State:
        """The cloth at the end of an action, at rest; as it is where there was no search."""
        wanted = calibration.mean_m
        if not len(wanted):
            return state
        self._dynamics.solver.set_parameters(cloth_parameters(theta, self._dynamics.solver.mesh))
        strength = np.full((1, len(wanted)), FINAL_STRENGTH, np.float32)
        pull = Attachment(wanted[None].astype(np.float32), strength)
        return rolled_to(self._dynamics, state, pull, ROLL_S, self._name)


def chosen_candidate(
    state: State,
    theta: Theta,  # noqa: ARG001
    calibration: Calibration,  # noqa: ARG001
) -> State:
    """The end of the pass that was chosen as it is, as in the paper."""
    return state
