from dataclasses import replace

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import garment, towel
from clothtrack.geometry.quality import crossings, edge_strain
from clothtrack.reconstruction.data.view import points_of
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.reconstruction.smoothness import smoothness_matrix
from clothtrack.recordings.recording import Table
from clothtrack_lab.published_networks.canonical_frame import canonical_frame
from clothtrack_lab.published_networks.template_fit import (
    TemplateFitConfig,
    fit_template,
    template_of,
)

TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
UNPULLED = TemplateFitConfig(pulls=0)


def seen_points(folded, stride=4):
    pixels = np.argwhere(folded.depth > 0)
    pixels = pixels[(pixels % stride == 0).all(axis=1)]
    points = points_of(folded.depth, folded.camera, pixels)
    canonical = folded.canonical_at(*pixels.T, points)
    return SeenPoints(points, canonical, np.ones(len(points)))


def errors_mm(mesh, folded):
    return 1e3 * np.linalg.norm(mesh.vertices - folded.vertices, axis=1)


def test_true_pixels_give_the_folded_garment_back(folded):
    fitted = fit_template(folded.flat, seen_points(folded), TemplateFitConfig(), table=TABLE)
    errors = errors_mm(fitted, folded)
    # A plain fill left 8 to 9 mm of all, 3 of the seen and 13 to 20 of the hidden vertices.
    assert errors.mean() < 7.0
    assert errors[folded.visible].mean() < 5.0
    assert errors[~folded.visible].mean() < 9.0
    assert fitted.vertices[:, 2].min() > 0.0015 - 1e-4
    np.testing.assert_array_equal(fitted.canonical, folded.flat.canonical)


def test_the_solver_makes_a_cloth_of_the_fit(folded):
    seen = seen_points(folded)
    raw = fit_template(folded.flat, seen, UNPULLED, table=TABLE)
    fitted = fit_template(folded.flat, seen, TemplateFitConfig(), table=TABLE)
    assert edge_strain(folded.flat, fitted.vertices) < 0.01
    assert edge_strain(folded.flat, fitted.vertices) < 0.3 * edge_strain(folded.flat, raw.vertices)
    faces = folded.flat.faces
    before, after, true = (
        crossings(one, faces) for one in (raw.vertices, fitted.vertices, folded.vertices)
    )
    # The solver's own fold is not free of crossings where it is creased.
    assert after < before
    assert after <= 2 * true + 5


def test_wrong_pixels_are_outvoted(folded, rng):
    seen = seen_points(folded)
    canonical = seen.canonical.copy()
    wrong = rng.random(len(canonical)) < 0.1
    canonical[wrong] = rng.permutation(canonical)[wrong]
    misled = replace(seen, canonical=canonical)
    robust = fit_template(folded.flat, misled, UNPULLED)
    naive = fit_template(folded.flat, misled, replace(UNPULLED, outlier_m=1e6))
    seen_vertices = folded.visible
    assert errors_mm(robust, folded)[seen_vertices].mean() < 6.0
    assert (
        errors_mm(robust, folded)[seen_vertices].mean()
        < 0.5 * errors_mm(naive, folded)[seen_vertices].mean()
    )


def test_the_warp_field_decides_where_nothing_was_seen(folded_towel):
    flat = folded_towel.flat
    seen = seen_points(folded_towel)
    left = seen.canonical[:, 0] < 0
    half = SeenPoints(seen.points[left], seen.canonical[left], seen.confidence[left])
    without = fit_template(flat, half, UNPULLED)
    config = replace(UNPULLED, warp_weight=0.5)
    warped = fit_template(flat, half, config, warp=folded_towel.vertices)
    right = flat.canonical[:, 0] > 0.03
    told, guessed = errors_mm(warped, folded_towel)[right], errors_mm(without, folded_towel)[right]
    assert told.mean() < 0.25 * guessed.mean()


@pytest.mark.parametrize("pattern", ["alternating", "random"])
def test_a_flat_sheet_bends_nowhere_however_it_lies(pattern, rng):
    mesh = towel(0.3, 0.3, 0.02, pattern=pattern)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    moved = mesh.vertices @ turn.T + rng.normal(size=3)
    bends = smoothness_matrix(mesh)
    assert np.abs(bends @ moved).max() < 1e-9
    curved = mesh.vertices + [0, 0, 1] * (5 * mesh.vertices[:, :1] ** 2)
    assert np.abs(bends @ curved).max() > 1e-4


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_the_size_is_read_from_the_canonical_coordinates(kind):
    size = {"towel": (0.26, 0.32), "tshirt": (0.54, 0.41)}[kind]
    canonical = garment(kind, vertex_count=2000, size_m=size).canonical
    seen = SeenPoints(np.zeros_like(canonical), canonical, np.ones(len(canonical)))
    found = template_of(canonical_frame(kind), seen)
    np.testing.assert_allclose(np.ptp(found.vertices[:, :2], axis=0), size, rtol=0.08)
    known = template_of(canonical_frame(kind), seen, size_m=(0.3, 0.3), vertex_count=300)
    np.testing.assert_allclose(np.ptp(known.vertices[:, :2], axis=0), 0.3, rtol=0.01)
