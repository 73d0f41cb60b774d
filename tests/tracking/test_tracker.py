"""What the tracker does between its parts: when it slides a cloth, and what it takes hold of."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from clothtrack.geometry.quality import crossing_edges, crossings
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import Recording
from clothtrack.tracking import final_alignment
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.methods import Assembled, Components, default
from clothtrack.tracking.pipeline import track_recording
from clothtrack.tracking.search import SearchConfig
from clothtrack.tracking.visible_alignment import only_at

CONFIG = RunConfig(
    color=False,
    cloth=replace(RunConfig().cloth, substep_s=3.3e-3),
    search=SearchConfig(method="none"),
)
"""The default without a search, at the substep of a smoke run; nothing is followed in color."""


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


def tracked(recording: Recording, **last):
    """The recording, tracked with changes to the final alignment."""

    def assemble(components):
        assembled = default(components)
        align_last = replace(assembled.method.align_last, **last)
        return replace(assembled, method=replace(assembled.method, align_last=align_last))

    return track_recording(recording, CONFIG, assemble=assemble if last else None)


def test_a_cloth_that_nobody_holds_is_slid_before_the_final_alignment(recording, slides):
    result = tracked(recording)
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


@pytest.mark.parametrize("why", ["held", "no table", "switched off"])
def test_a_cloth_that_must_not_slide_is_left_where_it_is(recording, slides, why):
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
    tracked(recording, **({"slide": False} if why == "switched off" else {}))
    # Nobody holds the first mesh yet; it is slid before anything is switched off.
    assert len(slides) == (why != "no table")


def test_the_first_mesh_is_aligned_to_its_cloud_before_anything_moves(recording, slides):
    mesh = recording.cloth.template
    shift = np.array([0.004, -0.003, 0.0])
    beside = replace(
        recording,
        cloth=replace(recording.cloth, template=mesh.with_vertices(mesh.vertices + shift)),
    )
    result = tracked(beside)
    np.testing.assert_allclose(slides[0][0], mesh.vertices + shift, atol=1e-6)
    off = np.linalg.norm(result.positions[0] - mesh.vertices, axis=1).mean()
    assert off < 0.4 * np.linalg.norm(shift)
    # Its rest lengths are those that it came with.
    np.testing.assert_array_equal(result.mesh.vertices, beside.cloth.template.vertices)
    left = track_recording(beside, CONFIG, assemble=as_it_comes)
    np.testing.assert_allclose(left.positions[0], mesh.vertices + shift, atol=1e-6)


def as_it_comes(components: Components) -> Assembled:
    """Ours, with the first mesh as it comes."""
    state = components.simulator(velocity_kept=0.0).solver.save()
    return replace(default(components), state=state)


@pytest.mark.parametrize("attach_crossed", [False, True])
def test_vertices_at_crossings_are_left_free_unless_the_paper_is_followed(
    recording, attach_crossed
):
    mesh = recording.cloth.template
    components = Components(recording, mesh, CONFIG, partial(observe, recording))
    align = replace(default(components).method.align, uncrossed_only=not attach_crossed)
    crossing = dipping(mesh)
    edges, faces = crossing_edges(crossing, mesh.faces)
    crossed = np.unique(np.concatenate([edges.ravel(), faces.ravel()]))
    assert 10 < len(crossed) < 0.5 * len(crossing)

    correction = align.aligned(crossing, observe(recording, recording.frames[0]))
    assert correction.attached[crossed].any() == attach_crossed
    assert correction.attached.sum() > 0.3 * len(correction.attached)


def dipping(mesh):
    """A third of a cloth is folded over, and dips through what lies under it."""
    beyond = np.clip(mesh.vertices[:, 0] - mesh.vertices[:, 0].mean() - 0.03, 0.0, None)[:, None]
    return mesh.vertices - beyond * [2.0, 0.0, 0.1] + (beyond > 0.0) * [0.0, 0.003, 0.004]


@pytest.mark.parametrize("untangle", [False, True])
def test_an_action_ends_with_a_cloth_that_is_untangled_if_asked(recording, untangle):
    mesh = recording.cloth.template
    eyes = partial(observe, recording)
    components = Components(recording, mesh, CONFIG, eyes, start=dipping(mesh))
    assembled = as_it_comes(components)
    align_last = replace(assembled.method.align_last, untangle=untangle, slide=False)
    nothing = only_at((), eyes, recording)(recording.frames[0])
    state = assembled.state
    assert crossings(state.positions[0], mesh.faces) > 20
    last, _ = align_last(state, CONFIG.cloth.theta(), nothing, False)
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
