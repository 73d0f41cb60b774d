"""The candidates of a search: their spread, their mean, and how the cloth gets there."""

import numpy as np
import pytest

from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.parameters import SolverConfig
from clothtrack.simulation.solver import ClothSolver
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.ensemble import (
    SCORE_SCALE,
    MeanOfCandidates,
    ensemble_spread,
    mean_end,
)
from clothtrack.tracking.picking import HeldCloth
from clothtrack.tracking.protocols import Candidate, TrackedCandidate
from clothtrack.tracking.tracked_trajectory import StepRecords


def test_vertices_at_which_passes_end_apart_are_told():
    one, other, gone = (np.full((5, 3), each, np.float32) for each in (0.0, 0.0, np.nan))
    other[2] = 0.0, 0.006, 0.0
    np.testing.assert_allclose(ensemble_spread([one, other]), [0, 0, 0.003, 0, 0], atol=1e-9)
    assert ensemble_spread([one, gone]).shape == ensemble_spread([]).shape == (0,)


def test_candidates_that_fit_alike_weigh_alike_and_bad_ones_nothing():
    ends = [np.full((4, 3), each) for each in (0.0, 1.0, 5.0, np.nan)]
    np.testing.assert_allclose(mean_end(ends, [0.04, 0.04, 0.4, np.inf]), 0.5, atol=1e-9)
    worse = 0.04 * (1.0 + SCORE_SCALE)
    expected = np.exp(-1.0) / (1.0 + np.exp(-1.0))
    np.testing.assert_allclose(mean_end(ends[:2], [0.04, worse]), expected)
    # An outline that fits to the pixel scores 0.
    np.testing.assert_allclose(mean_end(ends[:2], [0.0, 0.0]), 0.5)


def tracked(recording, state) -> TrackedCandidate:
    """A candidate that ends with this state."""
    candidate = Candidate(RunConfig().cloth.theta(), HeldCloth((), np.zeros(3)))
    ends = np.asarray(state.positions, np.float32)
    return TrackedCandidate(
        recording.actions[0], candidate, ends, state, StepRecords.empty(len(recording.frames))
    )


@pytest.mark.parametrize("shift_m", [0.0004, 0.004])
def test_the_cloth_is_rolled_to_the_mean_however_near_it_is(recording, shift_m):
    solver = ClothSolver(recording.cloth.template, SolverConfig(table=recording.table))
    solver.step(0.02)
    before = solver.save()
    shift = np.float32([shift_m, 0.0, 0.0])
    ends = [before.positions[0] + shift - across for across in (shift, -shift)]
    move = MeanOfCandidates(ClothDynamics(solver), "towel")
    moved = move(tracked(recording, before), ends, [0.1, 0.1])
    off = np.linalg.norm(moved.positions[0] - before.positions[0] - shift, axis=1)
    assert off.max() < 0.1 * shift_m
    assert not moved.velocities.any()
