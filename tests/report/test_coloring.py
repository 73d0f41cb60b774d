from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.label_evidence import LabelEvidence
from clothtrack.evaluation.label_quality import LabelQuality
from clothtrack.evaluation.truth import Truth
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.report.coloring import cloud_gaps, colorings, expected_errors, truth_errors


def judged(*errors_mm):
    evidence = LabelEvidence(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1)
    return [LabelQuality(k, 0, error, evidence) for k, error in enumerate(errors_mm)]


def test_a_visible_vertex_has_its_distance_to_the_cloud_a_hidden_one_has_none(tracked):
    clouds = [positions.astype(float) + (0, 0, 0.003) for positions in tracked.positions]
    clouds[0] = np.empty((0, 3))
    gaps = cloud_gaps(tracked, clouds).values
    assert np.isnan(gaps[0]).all()
    assert np.isnan(gaps[1:][~tracked.visible[1:]]).all()
    seen = gaps[1:][tracked.visible[1:]]
    assert seen.max() == pytest.approx(3.0, abs=1e-3)
    flat = gaps[1][np.abs(tracked.positions[1][:, 0]) > 0.02]
    np.testing.assert_allclose(flat[np.isfinite(flat)], 3.0, atol=0.4)


def test_the_error_to_expect_is_that_of_the_frames_action(tracked):
    later = replace(tracked, frames=tracked.frames + 1)
    assert np.isnan(expected_errors(later, judged(2.0, 9.0)).values[-1]).all()
    values = expected_errors(tracked, judged(2.0, 9.0)).values
    np.testing.assert_allclose(values[:3], 2.0)
    np.testing.assert_allclose(values[3:], 9.0)


def test_where_candidates_disagree_more_error_is_expected(tracked):
    spread = np.linspace(0.0, 1e-3, tracked.mesh.vertex_count)
    first, *others = tracked.actions
    first = replace(first, calibration=replace(first.calibration, spread_m=spread))
    known = replace(tracked, actions=(first, *others))
    values = expected_errors(known, judged(2.0, 9.0)).values
    assert values[0].mean() == pytest.approx(2.0)
    assert (np.diff(values[0]) > 0.0).all()
    np.testing.assert_allclose(values[-1], 9.0)


def with_canonical(tracked):
    rest = tracked.mesh.vertices
    return replace(tracked, mesh=ClothMesh(rest, tracked.mesh.faces, rest))


def test_the_error_against_the_truth_is_the_distance_of_the_same_piece_of_cloth(tracked):
    known = with_canonical(tracked)
    frames = np.array([1, 4])
    positions = known.positions[frames].astype(float) + (0.003, 0.004, 0.0)
    truth = Truth(positions, known.mesh.faces, frames, known.mesh.canonical)
    found = truth_errors(known, truth)
    np.testing.assert_allclose(found.values[frames], 5.0, atol=1e-3)
    assert np.isnan(found.values[[0, 2, 3, 5]]).all()
    assert found.limit == 5.0
    assert "truth" in found.title


def test_a_truth_that_cannot_be_compared_is_refused(tracked):
    known = with_canonical(tracked)
    faces, canonical = known.mesh.faces, known.mesh.canonical
    late = Truth(known.positions[:1].astype(float), faces, np.array([99]), canonical)
    with pytest.raises(InvalidResultError, match="none of its frames"):
        truth_errors(known, late)
    with pytest.raises(InvalidResultError, match="canonical"):
        truth_errors(tracked, late)


def test_the_truth_is_named_only_where_it_is_given(tracked):
    clouds = [np.empty((0, 3))] * len(tracked.frames)
    keys = [one.key for one in colorings(tracked, clouds, judged(1.0, 2.0))]
    assert keys == ["cloud", "label"]
