"""The candidates of a search: where they end apart, their mean, and how the cloth gets there."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.geometry.quality import edge_strain
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.parameters import SolverConfig
from clothtrack.simulation.solver import ClothSolver
from clothtrack.tracking.calibration import CalibrationConfig
from clothtrack.tracking.configuration import MODES, TrackerConfig
from clothtrack.tracking.ensemble import SCORE_SCALE, MeanOfCandidates, ends_apart, mean_end
from clothtrack.tracking.pipeline import RunConfig, track_recording
from clothtrack.tracking.tracked_trajectory import Calibration


def test_vertices_at_which_passes_end_apart_are_told():
    one, other, gone = (np.full((5, 3), each, np.float32) for each in (0.0, 0.0, np.nan))
    other[2] = 0.0, 0.006, 0.0
    np.testing.assert_allclose(ends_apart([one, other]), [0, 0, 0.003, 0, 0], atol=1e-9)
    assert ends_apart([one, gone]).shape == ends_apart([]).shape == (0,)


def test_candidates_that_fit_alike_weigh_alike_and_bad_ones_nothing():
    ends = [np.full((4, 3), each) for each in (0.0, 1.0, 5.0, np.nan)]
    np.testing.assert_allclose(mean_end(ends, [0.04, 0.04, 0.4, np.inf]), 0.5, atol=1e-9)
    worse = 0.04 * (1.0 + SCORE_SCALE)
    expected = np.exp(-1.0) / (1.0 + np.exp(-1.0))
    np.testing.assert_allclose(mean_end(ends[:2], [0.04, worse]), expected)
    # An outline that fits to the pixel scores 0.
    np.testing.assert_allclose(mean_end(ends[:2], [0.0, 0.0]), 0.5)


@pytest.mark.parametrize("scores", [[], [0.1], [0.1, np.inf]])
def test_one_candidate_has_no_mean(scores):
    assert mean_end([np.zeros((4, 3))] * len(scores), scores).shape == (0, 3)


@pytest.mark.parametrize("shift_m", [0.0004, 0.004])
def test_the_cloth_is_rolled_to_the_mean_however_near_it_is(recording, shift_m):
    mesh = recording.cloth.template
    table = recording.table
    solver = ClothSolver(mesh, SolverConfig(table=table))
    solver.step(0.02)
    before = solver.save()
    wanted = before.positions[0] + np.float32([shift_m, 0.0, 0.0])
    calibration = replace(Calibration.none(), mean_m=wanted.astype(np.float64))
    theta = TrackerConfig().parameters
    moved = MeanOfCandidates(ClothDynamics(solver), "towel")(before, theta, calibration)
    off = np.linalg.norm(moved.positions[0] - wanted, axis=1)
    assert off.max() < 0.1 * shift_m
    assert not moved.velocities.any()


def test_where_nothing_was_searched_the_pass_is_left_as_it_is(recording):
    solver = ClothSolver(recording.cloth.template, SolverConfig())
    state = solver.save()
    move = MeanOfCandidates(ClothDynamics(solver), "towel")
    assert move(state, TrackerConfig().parameters, Calibration.none()) is state


def test_a_search_goes_on_from_the_mean_and_keeps_it(recording):
    axes = {"table_friction": (0.05, 1.0), "bend_compliance": (0.1, 10.0)}
    base = TrackerConfig()
    config = replace(
        base,
        calibration=CalibrationConfig(method="grid", judge="tracking", axes=axes),
        solver=replace(base.solver, substep_s=3.3e-3),
    )
    mean, best = (
        track_recording(recording, RunConfig(tracker=replace(config, average_candidates=each)))
        for each in (True, False)
    )
    (action,), (alone,) = mean.actions, best.actions
    np.testing.assert_array_equal(action.calibration.mean_m, alone.calibration.mean_m)
    np.testing.assert_array_equal(
        action.positions_before_final_alignment, alone.positions_before_final_alignment
    )
    assert not np.array_equal(mean.positions[-1], best.positions[-1])
    assert edge_strain(mean.mesh, action.positions_after_final_alignment) < 0.01


def test_no_mode_of_the_paper_averages_or_aligns_first():
    for name, config in MODES.items():
        assert config.average_candidates == config.align_first_mesh == (name == "default")
