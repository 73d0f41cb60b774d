"""Coverage of candidates, in the picture."""

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.camera import Camera
from clothtrack.planning.planner import coverage

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


def test_only_cloth_in_the_picture_counts_and_no_triangle_on_its_border():
    """The camera sees x from -0.1 to 0.0455: of the towel's edges at every centimeter, to 0.04."""
    above = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1], [0, 0, 0, 1]])
    camera = Camera("top", 291, 400, 2000.0, 2000.0, 199.5, 199.5, above)
    cloth = np.stack([FLAT.vertices, FLAT.vertices + [1.0, 0.0, 0.0]])
    seen = coverage(cloth, FLAT.faces, camera=camera)
    assert seen == pytest.approx([0.014, 0.0], rel=1e-6)
