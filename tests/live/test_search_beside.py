"""Candidates are tracked beside the stream, and what is found is what `track` finds, to the bit."""

import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import clothtrack as ct
from clothtrack_lab.world import SMALL_WORLD
from clothtrack_lab.world.episodes import simulate_trajectory

PATIENCE_S = 120.0
EVERY_ACTION = ["search.stop_score=0", "search.sweeps=1"]
"""Even those whose first candidate is good enough."""


@pytest.fixture(scope="module")
def twice(tmp_path_factory, film):
    """Two actions of a napkin."""
    config = replace(SMALL_WORLD, actions=2)
    folder = simulate_trajectory("towel", 5, tmp_path_factory.mktemp("twice"), config=config)
    return type(film)(ct.read_recording(folder))


@pytest.fixture(scope="module")
def offline(twice):
    return ct.track(twice.recording, settings=EVERY_ACTION)


def assert_same(run, offline):
    np.testing.assert_array_equal(run.positions, offline.positions)
    np.testing.assert_array_equal(run.visible, offline.visible)
    np.testing.assert_array_equal(run.steps.loss_after, offline.steps.loss_after)
    np.testing.assert_array_equal(run.steps.trials, offline.steps.trials)
    for here, there in zip(run.actions, offline.actions, strict=True):
        assert (here.first_frame, here.last_frame) == (there.first_frame, there.last_frame)
        assert here.held_vertices == there.held_vertices
        assert here.parameters == there.parameters
        assert here.calibration.best == there.calibration.best
        for name in ("candidates", "scores", "spread_m"):
            found = (getattr(one.calibration, name) for one in (here, there))
            np.testing.assert_array_equal(*found)
        for name in (
            "final_alignment_losses",
            "positions_before_final_alignment",
            "positions_after_final_alignment",
        ):
            np.testing.assert_array_equal(getattr(here, name), getattr(there, name))


def searching_processes():
    """Those that this process has started."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:  # it has ended meanwhile
            continue
        if parent == os.getpid() and any(b"search_process" in word for word in words):
            found.append(int(folder.name))
    return found


@pytest.mark.slow
def test_searches_that_end_after_the_film_give_what_track_gives(twice, offline):
    tracker = twice.tracker(settings=EVERY_ACTION)
    states = twice.follow(tracker, range(len(twice)))
    run = tracker.close()
    # The second action began before the first was searched: its search begins from that answer.
    assert any(state.searching and state.acting for state in states)
    searches = run.provenance["live"]["searches"]
    assert [each["candidates"] for each in searches] == [
        len(action.calibration.scores) for action in offline.actions
    ]
    assert_same(run, offline)


@pytest.mark.slow
def test_the_next_action_starts_from_what_was_found_before_it(twice):
    tracker = twice.tracker(settings=EVERY_ACTION, keep_pictures=True)
    first, _ = twice.recording.actions
    states = twice.follow(tracker, range(first.last_frame + 1))
    rest, waits, end = twice.picture(first.last_frame), 0, time.monotonic() + PATIENCE_S
    while not waits or states[-1].settling or states[-1].searching:
        assert time.monotonic() < end
        waits += 1
        states.append(tracker.update(**(rest | {"time_s": rest["time_s"] + 0.1 * waits})))
        time.sleep(0.2)
    before = states[-1].positions
    for index in range(first.last_frame + 1, len(twice)):
        shown = twice.picture(index)
        if index == first.last_frame + 1:
            tracker.begin_action()
        if index == len(twice) - 1:
            tracker.end_action()
        tracker.update(**(shown | {"time_s": shown["time_s"] + 0.1 * waits}))
    run = tracker.close()
    searches = run.provenance["live"]["searches"]
    assert searches[0]["frame"] <= first.last_frame + waits
    moved = [note for state in states for note in state.notes if "moves the mesh by" in note]
    assert len(moved) == (searches[0]["moved_m"] > 0.0)
    found = run.actions[0].positions_after_final_alignment
    np.testing.assert_array_equal(before, found.astype(np.float32))
    assert_same(run, ct.track(run.recording, settings=EVERY_ACTION))


@pytest.mark.slow
def test_a_process_that_dies_leaves_what_was_tracked_live(twice):
    tracker = twice.tracker(settings=EVERY_ACTION)
    first = twice.recording.actions[0]
    twice.follow(tracker, range(first.last_frame))
    end = time.monotonic() + PATIENCE_S
    while not (found := searching_processes()):
        assert time.monotonic() < end
        time.sleep(0.05)
    os.kill(found[0], signal.SIGKILL)
    states = twice.follow(tracker, range(first.last_frame, len(twice)))
    run = tracker.close()
    assert run.provenance["live"]["searches"] == []
    said = [note for state in states for note in state.notes if "searched any more" in note]
    assert len(said) <= 1  # once at most; not at all where the film ended first
    without = ct.track(twice.recording, settings=["search.method=none"])
    np.testing.assert_array_equal(run.positions, without.positions)
