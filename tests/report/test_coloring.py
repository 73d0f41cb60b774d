from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.truth import Truth
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.report.coloring import cloud_gaps, truth_errors


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
