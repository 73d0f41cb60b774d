"""Candidates are tracked beside the stream, and what is found is what `track` finds, to the bit."""

import time

import numpy as np
import pytest

import clothtrack as ct

ALL_OF_TWO = ["search.stop_score=0", "search.sweeps=1", "search.axes.held_layers=1"]


@pytest.fixture(scope="module")
def offline(film):
    return ct.track(film.recording, settings=SETTINGS)


SETTINGS = ["search.stop_score=0", "search.sweeps=1"]


def assert_same(run, offline):
    assert np.array_equal(run.positions, offline.positions)
    assert np.array_equal(run.visible, offline.visible)
    for here, there in zip(run.actions, offline.actions, strict=True):
        assert (here.first_frame, here.last_frame) == (there.first_frame, there.last_frame)
        assert here.held_vertices == there.held_vertices
        assert here.parameters == there.parameters
        assert np.array_equal(here.calibration.candidates, there.calibration.candidates)
        assert np.array_equal(here.calibration.scores, there.calibration.scores)
        assert here.calibration.best == there.calibration.best
        assert np.array_equal(here.calibration.spread_m, there.calibration.spread_m)
        assert np.array_equal(here.final_alignment_losses, there.final_alignment_losses)
        assert np.array_equal(
            here.positions_before_final_alignment, there.positions_before_final_alignment
        )
        assert np.array_equal(
            here.positions_after_final_alignment, there.positions_after_final_alignment
        )
    assert np.array_equal(run.steps.loss_after, offline.steps.loss_after, equal_nan=True)
    assert np.array_equal(run.steps.trials, offline.steps.trials)


def test_searches_that_are_waited_for_at_the_end_alone_give_what_track_gives(film, offline):
    tracker = film.tracker(settings=SETTINGS)
    states = film.follow(tracker, range(len(film)))
    run = tracker.close()
    print(run.provenance["live"], [len(a.calibration.scores) for a in offline.actions])
    print([(a.first_frame, a.last_frame) for a in offline.actions], [s.searching for s in states])
    assert_same(run, offline)
