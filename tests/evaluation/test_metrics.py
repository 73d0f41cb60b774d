"""Laws of the measures: zero for the truth, the distance for a shift, the area for a flat cloth."""

import numpy as np
import pytest

from clothtrack.evaluation.metrics import (
    below_table,
    chamfer_pc,
    chamfer_surface,
    cloth_measures,
    root_mean_square_mm,
    vertex_error_mm,
)
from clothtrack.garments.garment_meshes import towel
from clothtrack.recordings.recording import Table

TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))


@pytest.fixture
def sheet():
    return towel(0.2, 0.1, 0.02)


def shift_of(length_m, rng):
    direction = rng.normal(size=3)
    return length_m * direction / np.linalg.norm(direction)


def test_the_truth_scores_zero_against_itself(sheet):
    seen = np.arange(sheet.vertex_count) % 3 > 0
    errors = vertex_error_mm(sheet.vertices, sheet.vertices, seen)
    assert set(errors) == {"all", "visible", "hidden"}
    for summary in errors.values():
        assert (summary.mean, summary.median, summary.p95, summary.max) == (0.0, 0.0, 0.0, 0.0)
    assert errors["visible"].count + errors["hidden"].count == errors["all"].count


def test_a_shift_of_five_millimeters_is_five_millimeters_everywhere(sheet, rng):
    seen = np.arange(sheet.vertex_count) % 3 > 0
    moved = sheet.vertices + shift_of(0.005, rng)
    for summary in vertex_error_mm(moved, sheet.vertices, seen).values():
        found = (summary.mean, summary.median, summary.p95, summary.max)
        np.testing.assert_allclose(found, 5.0, rtol=1e-9)


def test_chamfer_of_a_shifted_cloud_is_the_shift(sheet, rng):
    """Points 20 mm apart: the nearest one stays the same for a shift of 5 mm."""
    seen = np.ones(sheet.vertex_count, bool)
    shift = shift_of(0.005, rng)
    assert chamfer_pc(sheet.vertices, seen, sheet.vertices) == 0.0
    value = chamfer_pc(sheet.vertices, seen, sheet.vertices + shift)
    assert value == pytest.approx(2 * 0.005**2)
    assert root_mean_square_mm(value) == pytest.approx(5.0)


def test_a_surface_against_itself_scores_only_its_sampling(sheet):
    surface = (sheet.vertices, sheet.faces)
    spacing = np.sqrt(0.2 * 0.1 / 4000)
    assert chamfer_surface(surface, surface, samples=4000) < 2 * spacing**2
    raised = (sheet.vertices + [0.0, 0.0, 0.05], sheet.faces)
    assert chamfer_surface(surface, raised, samples=4000) == pytest.approx(2 * 0.05**2, rel=0.02)


def test_a_flat_cloth_at_rest_has_no_fault_and_covers_its_area(sheet):
    resting = sheet.vertices + [0.0, 0.0, 0.0015]
    found = cloth_measures(sheet, resting, TABLE, rest_height_m=0.0015)
    assert found.edge_strain == pytest.approx(0.0, abs=1e-12)
    assert (found.crossings, found.close_pairs, found.below_table) == (0, 0, 0.0)
    assert found.coverage == pytest.approx(0.2 * 0.1)
    assert set(found.as_dict()) == {
        "edge_strain", "crossings", "close_pairs", "below_table", "coverage",
    }  # fmt: skip


def test_stretch_is_strain_and_area(sheet):
    found = cloth_measures(sheet, 1.03 * sheet.vertices, None, rest_height_m=0.0)
    assert found.edge_strain == pytest.approx(0.03)
    assert found.coverage == pytest.approx(1.03**2 * 0.2 * 0.1)
    assert np.isnan(found.below_table)


def test_a_fold_halves_the_coverage_and_a_fold_through_the_cloth_crosses(sheet):
    folded = sheet.vertices.copy()
    right = folded[:, 0] > 1e-9
    folded[right] *= [-1.0, 1.0, 1.0]
    folded[right, 2] = 0.01
    found = cloth_measures(sheet, folded, TABLE, rest_height_m=0.0)
    assert found.coverage == pytest.approx(0.1 * 0.1)
    assert (found.crossings, found.close_pairs) == (0, 0)
    # The flap comes down through the other half: half of it is on the wrong side.
    folded[right, 2] = 0.01 + 0.3 * folded[right, 0]
    found = cloth_measures(sheet, folded, TABLE, rest_height_m=0.0)
    assert found.crossings > 0
    assert found.close_pairs > 0
    assert found.below_table > 0.1


def test_below_the_table_is_more_than_three_millimeters_under_rest(sheet):
    tilted = Table(np.array([0.0, 0.0, 0.2]), np.array([0.6, 0.0, 0.8]))
    on_it = sheet.vertices @ np.array([[0.8, 0, -0.6], [0, 1, 0], [0.6, 0, 0.8]])
    on_it = on_it + tilted.point + 0.0015 * tilted.normal
    assert below_table(on_it, tilted, 0.0015) == 0.0
    assert below_table(on_it - 0.0029 * tilted.normal, tilted, 0.0015) == 0.0
    assert below_table(on_it - 0.0031 * tilted.normal, tilted, 0.0015) == 1.0
