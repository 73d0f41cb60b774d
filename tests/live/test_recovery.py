"""A mesh that has lost the cloth says so, and begins anew from what the network sees."""

import time

import numpy as np
import pytest

import clothtrack as ct
from clothtrack.garments import garment
from clothtrack.live.live_judge import Judgment
from clothtrack.live.recovery import LOST_SHARE, Recovery
from clothtrack.tracking.configuration import InitialStateConfig
from clothtrack.tracking.initial_state import InitialState

CONFIG = InitialStateConfig()


def judged(time_s, share):
    return Judgment(time_s, np.zeros(100), np.arange(100) < 100 * share)


def test_the_cloth_is_lost_when_two_judgments_say_so_and_that_is_said_once():
    recovery = Recovery(CONFIG, None, "cpu")
    much, little = LOST_SHARE + 0.05, LOST_SHARE - 0.05
    assert not recovery.look(judged(1.0, much))
    assert not recovery.look(judged(1.0, much))  # the same judgment again
    assert not recovery.astray
    assert not recovery.look(judged(1.5, little))
    assert not recovery.look(judged(2.0, much))
    assert "has lost the cloth" in recovery.look(judged(2.5, much))
    assert recovery.astray
    assert not recovery.look(judged(3.0, much))
    assert not recovery.look(judged(3.5, little))
    assert not recovery.astray


def test_a_mesh_of_another_triangulation_is_carried_over_and_a_farther_one_is_not_taken(film):
    recording = film.recording
    seen = ct.observe(recording, recording.frames[0])
    mesh = recording.cloth.template
    other = garment("towel", vertex_count=400, size_m=(0.16, 0.16))
    there = mesh.vertices.astype(np.float64)
    beside = there + (0.08, 0.0, 0.0)
    recovery = Recovery(CONFIG, None, "cpu")
    same = InitialState(mesh, there, {"source": "network"})
    found = recovery.better(same, mesh, beside, seen)
    np.testing.assert_allclose(found.positions, there, atol=1e-6)
    assert "does not begin anew" in recovery.better(
        InitialState(mesh, beside, {"source": "network"}), mesh, there, seen
    )
    shown = other.vertices.astype(np.float64) + there.mean(axis=0) - other.vertices.mean(axis=0)
    laid = recovery.better(InitialState(other, shown, {}), mesh, beside, seen)
    assert len(laid.positions) == mesh.vertex_count
    nameless = ct.ClothMesh(mesh.vertices, mesh.faces)
    assert "canonical" in recovery.better(same, nameless, beside, seen)


@pytest.mark.slow
def test_a_cloth_that_somebody_moved_is_found_again(film):
    pytest.importorskip("torch", reason="the extra [learn] brings it")
    tracker = film.tracker()
    picture = film.picture(0) | {"picker": None}
    first = tracker.update(**picture)
    moved = {name: np.roll(picture[name], 50, axis=1) for name in ("depth", "color")}
    states, end = [], time.monotonic() + 300
    while not any("begins anew" in note for state in states[-1:] for note in state.notes):
        assert time.monotonic() < end, [note for state in states for note in state.notes]
        time_s = 0.3 * (len(states) + 1)
        states.append(tracker.update(**(picture | moved | {"time_s": time_s})))
        time.sleep(0.05)
    assert any(state.astray for state in states)
    assert any("has lost the cloth" in note for state in states for note in state.notes)
    last, before = states[-1], states[-2]
    assert np.array_equal(before.positions, first.positions)
    camera = tracker.camera
    shift_m = 50 * np.median(picture["depth"]) / camera.fx
    went = last.positions.mean(axis=0) - first.positions.mean(axis=0)
    np.testing.assert_allclose(went @ camera.world_from_camera[:3, 0], shift_m, atol=0.02)
    for later in range(1, 200):
        state = tracker.update(**(picture | moved | {"time_s": last.time_s + 0.3 * later}))
        if state.judged_s > last.time_s + 0.3:
            break
        time.sleep(0.05)
    assert not state.astray
    assert state.lost.mean() < LOST_SHARE
    run = tracker.close()
    (anew,) = run.provenance["live"]["begun_anew"]
    assert (anew["frame"], anew["source"]) == (last.frame, "network")
    assert np.array_equal(run.positions[last.frame - 1], first.positions)
    assert np.array_equal(run.positions[last.frame], last.positions)
