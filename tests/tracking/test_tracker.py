"""What the tracker does between its parts: when it slides a cloth, and what it takes hold of."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from clothtrack.geometry.quality import crossing_edges, crossings
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import Recording
from clothtrack.tracking import final_alignment
from clothtrack.tracking.configuration import TrackerConfig
from clothtrack.tracking.pipeline import RunConfig, track_recording
from clothtrack.tracking.tracker import Tracker
from clothtrack.tracking.visible_alignment import only_at


@pytest.fixture
def config() -> TrackerConfig:
    """The default without a search, at the substep of a smoke run."""
    base = TrackerConfig()
    return replace(
        base,
        calibration=replace(base.calibration, method="none"),
        solver=replace(base.solver, substep_s=3.3e-3),
    )


@pytest.fixture
def slides(monkeypatch) -> list:
    """Every slide to the outline that is made: vertices before and after."""
    made = []
    slide = final_alignment.slide_to_outline

    def noted(mesh, vertices, *others, **named):
        after = slide(mesh, vertices, *others, **named)
        made.append((vertices, after))
        return after

    monkeypatch.setattr(final_alignment, "slide_to_outline", noted)
    return made


def without_color(config: TrackerConfig) -> TrackerConfig:
    """Nothing is followed in the pictures."""
    return replace(config, alignment=replace(config.alignment, marks_weight=0.0))


def tracked(recording: Recording, config: TrackerConfig):
    return track_recording(recording, RunConfig(tracker=config))


def test_a_cloth_that_nobody_holds_is_slid_before_the_final_alignment(recording, config, slides):
    result = tracked(recording, without_color(config))
    (action,) = result.actions
    _, (before, after) = slides
    np.testing.assert_array_equal(before, action.positions_before_final_alignment)
    # As a whole, along the table: every edge as long as before, every vertex as high.
    edges = result.mesh.edges
    np.testing.assert_allclose(_lengths(after, edges), _lengths(before, edges), rtol=1e-6)
    np.testing.assert_allclose(after[:, 2], before[:, 2], atol=1e-9)
    assert np.isfinite(action.positions_after_final_alignment).all()


def _lengths(vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1)


@pytest.mark.parametrize("why", ["held", "no table", "switched off", "no TTO2"])
def test_a_cloth_that_must_not_slide_is_left_where_it_is(recording, config, slides, why):
    if why == "held":
        last = recording.actions[-1].last_frame
        pickers = {
            name: replace(path, closed=path.closed | (path.time_s >= path.time_s[path.closed][0]))
            for name, path in recording.picker_paths.items()
        }
        recording = replace(recording, picker_paths=pickers)
        assert any(p.closed_at(recording.frames[last].time_s) for p in pickers.values())
    elif why == "no table":
        recording = replace(recording, table=None)
    elif why == "switched off":
        config = replace(config, final_alignment=replace(config.final_alignment, slide=False))
    else:
        config = replace(config, use_final_alignment=False)
    tracked(recording, without_color(config))
    # Nobody holds the first mesh yet.
    assert len(slides) == (why == "held")


def test_the_first_mesh_is_aligned_to_its_cloud_before_anything_moves(recording, config, slides):
    mesh = recording.cloth.template
    shift = np.array([0.004, -0.003, 0.0])
    beside = replace(
        recording,
        cloth=replace(recording.cloth, template=mesh.with_vertices(mesh.vertices + shift)),
    )
    result = tracked(beside, config)
    np.testing.assert_allclose(slides[0][0], mesh.vertices + shift, atol=1e-6)
    off = np.linalg.norm(result.positions[0] - mesh.vertices, axis=1).mean()
    assert off < 0.4 * np.linalg.norm(shift)
    # Its rest lengths are those that it came with.
    np.testing.assert_array_equal(result.mesh.vertices, beside.cloth.template.vertices)
    left = tracked(beside, replace(config, align_first_mesh=False))
    np.testing.assert_allclose(left.positions[0], mesh.vertices + shift, atol=1e-6)


def test_a_first_mesh_of_which_the_cloud_shows_little_stays_where_it_is(recording, config, slides):
    mesh = recording.cloth.template
    eyes = partial(observe, recording)
    cut = lambda frame: replace(eyes(frame), lowest_height_m=0.05)  # noqa: E731
    tracker = Tracker(recording, mesh, config, cut)
    np.testing.assert_allclose(tracker._state.positions[0], mesh.vertices, atol=1e-6)
    assert not slides
    assert len(Tracker(recording, mesh, config, eyes)._state.positions) == len(slides) == 1


@pytest.mark.parametrize("attach_crossed", [False, True])
def test_vertices_at_crossings_are_left_free_unless_the_paper_is_followed(
    recording, config, attach_crossed
):
    config = replace(config, attach_crossed=attach_crossed)
    mesh = recording.cloth.template
    tracker = Tracker(recording, mesh, config, partial(observe, recording))
    crossing = dipping(mesh)
    edges, faces = crossing_edges(crossing, mesh.faces)
    crossed = np.unique(np.concatenate([edges.ravel(), faces.ravel()]))
    assert 10 < len(crossed) < 0.5 * len(crossing)

    correction = tracker.parts.align.aligned(crossing, observe(recording, recording.frames[0]))
    assert correction.attached[crossed].any() == attach_crossed
    assert correction.attached.sum() > 0.3 * len(correction.attached)


def dipping(mesh):
    """A third of a cloth is folded over, and dips through what lies under it."""
    beyond = np.clip(mesh.vertices[:, 0] - mesh.vertices[:, 0].mean() - 0.03, 0.0, None)[:, None]
    return mesh.vertices - beyond * [2.0, 0.0, 0.1] + (beyond > 0.0) * [0.0, 0.003, 0.004]


@pytest.mark.parametrize("untangle", [False, True])
def test_an_action_ends_with_a_cloth_that_is_taken_apart_if_asked(recording, config, untangle):
    final = replace(config.final_alignment, untangle=untangle, slide=False)
    mesh = recording.cloth.template
    config = replace(config, final_alignment=final, align_first_mesh=False)
    tracker = Tracker(recording, mesh, config, partial(observe, recording), start=dipping(mesh))
    nothing = only_at((), partial(observe, recording), recording)(recording.frames[0])
    state = tracker._state
    assert crossings(state.positions[0], mesh.faces) > 20
    last, _ = tracker.parts.align_last(state, config.parameters, nothing, False)
    if not untangle:
        np.testing.assert_array_equal(last.positions, state.positions)
        return
    assert crossings(last.positions[0], mesh.faces) == 0
    moved = (last.positions != state.positions).any(axis=2)[0]
    assert 10 < moved.sum() < len(moved)
    # Sides are forgotten where layers may have been exchanged, and there only.
    pairs = last.contacts.sides != 0
    triangles = mesh.faces[np.abs(last.contacts.sides) - 1]
    assert not (pairs & (moved[triangles].any(axis=-1) | moved[:, None])).any()
    assert pairs.sum(axis=2).tolist() == last.contacts.counts.tolist()
    far = ~(moved[mesh.faces[np.abs(state.contacts.sides) - 1]].any(axis=(0, 2, 3)) | moved)
    np.testing.assert_array_equal(last.contacts.sides[:, far], state.contacts.sides[:, far])
