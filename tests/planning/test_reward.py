"""Coverage of candidates: exact, and as the literature counts it."""

import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.coverage import projected_area
from clothtrack.planning.reward import coverage, raster_coverage
from clothtrack.simulation.garments import towel

FLAT = towel(0.2, 0.1, 0.01)


def test_every_candidate_has_its_own_area_and_a_burst_one_none():
    half = FLAT.vertices.copy()
    half[:, 0] = np.abs(half[:, 0])
    burst = FLAT.vertices.copy()
    burst[3, 1] = np.nan
    areas = coverage(np.stack([FLAT.vertices, half, burst]), FLAT.faces)
    assert areas[0] == pytest.approx(0.02, rel=1e-6)
    assert areas[1] == pytest.approx(0.01, rel=1e-6)
    assert areas[2] == -np.inf


def test_the_raster_agrees_where_vertices_are_dense_and_level():
    fine = towel(0.2, 0.1, 0.004)
    assert raster_coverage(fine.vertices) == pytest.approx(0.02, rel=0.01)
    assert coverage(fine.vertices[None], fine.faces, "raster")[0] == raster_coverage(fine.vertices)


def test_the_raster_reads_too_little_on_a_coarse_mesh_and_the_exact_area_does_not():
    coarse = towel(0.2, 0.2, 0.025)
    assert raster_coverage(coarse.vertices) < 0.5 * 0.04
    assert projected_area(coarse.vertices, coarse.faces) == pytest.approx(0.04)


def test_the_raster_is_a_brute_force_count():
    points = np.random.default_rng(0).uniform(0.0, 0.1, (40, 3))
    cells, radius = 100, 0.005
    low, side = points[:, :2].min(axis=0), np.ptp(points[:, :2], axis=0) / cells
    first = np.clip(np.floor((points[:, :2] - radius - low) / side), 0, cells - 1).astype(int)
    last = np.clip(np.floor((points[:, :2] + radius - low) / side), 0, cells - 1).astype(int)
    grid = np.zeros((cells, cells), dtype=bool)
    for a, b in zip(first, last, strict=True):
        grid[a[0] : b[0] + 1, a[1] : b[1] + 1] = True
    assert raster_coverage(points) == pytest.approx(grid.sum() * side.prod())


def test_only_cloth_in_the_picture_counts_and_no_triangle_on_its_border():
    """The camera sees x from -0.1 to 0.0455: of the towel's edges at every centimetre, to 0.04."""
    above = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]])
    camera = Camera("top", 291, 400, 2000.0, 2000.0, 199.5, 199.5, above)
    cloth = np.stack([FLAT.vertices, FLAT.vertices + [1.0, 0.0, 0.0]])
    seen = coverage(cloth, FLAT.faces, camera=camera)
    assert seen == pytest.approx([0.014, 0.0], rel=1e-6)
    rastered = coverage(cloth, FLAT.faces, "raster", camera)
    left = FLAT.vertices[FLAT.vertices[:, 0] < 0.0455]
    assert rastered.tolist() == [raster_coverage(left), 0.0]
