"""Which vertices of a label to expect wrong."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.evaluation.label_evidence import LabelEvidence
from clothtrack.evaluation.label_quality import LabelQuality, expected_vertex_errors
from clothtrack.evaluation.local_misfit import LocalMisfit
from clothtrack.tracking.tracked_trajectory import Calibration, TrackedAction

NO_EVIDENCE = LabelEvidence(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1)


def action(spread_m):
    calibration = replace(Calibration.none(), spread_m=np.asarray(spread_m, float))
    mesh = np.zeros((4, 3), np.float32)
    return TrackedAction(0, 1, mesh, mesh, np.zeros(2), {}, calibration, {})


def label(expected_mm):
    return LabelQuality(0, 1, expected_mm, NO_EVIDENCE)


def test_the_mean_is_the_labels_and_the_spread_deals_it_out():
    spread = np.array([0.0, 1e-3, 2e-3, 5e-3])
    errors = expected_vertex_errors(action(spread), label(6.0))
    assert errors.mean() == pytest.approx(6e-3)
    # Affine in the spread, and nobody is without error.
    np.testing.assert_allclose(np.diff(errors) / np.diff(spread), (errors[3] - errors[0]) / 5e-3)
    assert 0.0 < errors[0] < errors[1] < errors[2] < errors[3]


@pytest.mark.parametrize("spread", [(), (0.0, 0.0, 0.0, 0.0)])
def test_without_a_spread_all_vertices_are_alike(spread):
    np.testing.assert_array_equal(expected_vertex_errors(action(spread), label(6.0)), 6e-3)


def test_a_patch_away_from_what_was_seen_is_expected_to_be_as_far_off():
    misfit_m = np.array([0.0, 1e-3, 2e-2, 3e-2])
    nothing = np.zeros(4)
    evidence = replace(NO_EVIDENCE, misfit=LocalMisfit(nothing, nothing, nothing, misfit_m))
    errors = expected_vertex_errors(action(()), replace(label(6.0), evidence=evidence))
    np.testing.assert_allclose(errors, [6e-3, 6e-3, 2e-2, 3e-2])


def test_where_nothing_was_seen_nothing_is_expected():
    assert np.isnan(expected_vertex_errors(action((0.0, 0.0, 1.0, 2.0)), label(np.nan))).all()
