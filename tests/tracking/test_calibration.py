"""Candidates that are tracked: each once, and the one whose outline fits is taken."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from clothtrack.tracking import algorithm
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.ensemble import best_candidate
from clothtrack.tracking.methods import Assembled, Components, default
from clothtrack.tracking.pipeline import track_recording
from clothtrack.tracking.search import SearchConfig

AXES = {"held_layers": (1, 2), "bend_compliance": (0.1, 10.0)}
CONFIG = RunConfig(
    cloth=replace(RunConfig().cloth, substep_s=3.3e-3),
    search=SearchConfig(axes=AXES, sweeps=1, stop_score=0.0),
)


def best_only(components: Components) -> Assembled:
    """Ours, going on from the best candidate."""
    assembled = default(components)
    calibrate = replace(assembled.method.calibrate, combine=best_candidate)
    return replace(assembled, method=replace(assembled.method, calibrate=calibrate))


@contextmanager
def counting():
    """Every action that is tracked, with the arguments that it is tracked with."""
    called = []
    track_action = algorithm.track_action

    def counted(*arguments, **named):
        called.append(arguments)
        return track_action(*arguments, **named)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(algorithm, "track_action", counted)
        yield called


@pytest.fixture(scope="module")
def searched(recording):
    """Tracked with the best candidate, and how many times an action was tracked for it."""
    with counting() as called:
        return track_recording(recording, CONFIG, assemble=best_only), len(called)


def test_the_candidate_with_the_best_outline_is_the_one_that_is_tracked(recording, searched):
    tracked, _ = searched
    (action,) = tracked.actions
    found = action.calibration
    assert (found.method, found.judge) == ("descent", "tracking")
    assert len(found.scores) == 3
    assert 0.0 < found.scores[found.best] < 0.2
    # Clearly better, or where the search began.
    assert found.scores[found.best] <= found.scores[0]
    taken = dict(zip(found.names, found.candidates[found.best].tolist(), strict=True))
    assert {name: action.parameters[name] for name in taken} == taken
    # The candidates part where the picker has moved the cloth, and hardly elsewhere.
    moved = np.linalg.norm(tracked.positions[-1] - tracked.positions[0], axis=1)
    still, carried = moved < np.quantile(moved, 0.2), moved > np.quantile(moved, 0.8)
    assert found.spread_m.shape == moved.shape
    assert found.spread_m[carried].mean() > 1.2 * found.spread_m[still].mean() > 0.0

    cloth = replace(CONFIG.cloth, bend_compliance=taken["bend_compliance"])
    alone = replace(CONFIG, cloth=cloth, search=SearchConfig(method="none"))
    again = track_recording(recording, alone)
    np.testing.assert_array_equal(tracked.positions, again.positions)
    np.testing.assert_array_equal(tracked.steps.loss_after, again.steps.loss_after)


def test_where_one_layer_lies_no_second_one_is_tracked(searched):
    tracked, times = searched
    (action,) = tracked.actions
    assert times == len(AXES["bend_compliance"])
    # The second layer shares the candidate of the first.
    first, second = action.calibration.scores[:2]
    assert first == second


def test_a_search_goes_on_from_the_mean_of_its_candidates(recording, searched):
    mean, (best, _) = track_recording(recording, CONFIG), searched
    (one,), (other,) = mean.actions, best.actions
    np.testing.assert_array_equal(one.calibration.scores, other.calibration.scores)
    np.testing.assert_array_equal(
        one.positions_before_final_alignment, other.positions_before_final_alignment
    )
    assert not np.array_equal(mean.positions[-1], best.positions[-1])


@pytest.mark.parametrize("method", [pytest.param("grid", marks=pytest.mark.slow), "descent"])
def test_the_papers_calibration_rolls_out_and_tracks_one_candidate(recording, method):
    axes = {"bend_compliance": (0.1, 10.0), "table_friction": (0.3, 1.0)}
    search = SearchConfig(method=method, axes=axes)
    with counting() as called:
        (action,) = track_recording(recording, replace(CONFIG, search=search)).actions
    found = action.calibration
    assert len(called) == 1
    assert (found.method, found.judge) == (method, "open_loop")
    assert len(found.scores) <= 4
    assert found.scores[found.best] == found.scores.min()
    assert found.spread_m.shape == (0,)
