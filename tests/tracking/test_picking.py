"""What a tip takes hold of: the layer on top, or several, counted from above."""

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import PickerPath
from clothtrack.tracking.picking import Grasp, layers_under

GAP_M = 0.004


@pytest.fixture
def folded() -> ClothMesh:
    """A towel folded over at x = 0: what was right of it lies above what was left."""
    flat = towel(0.2, 0.1, 0.01)
    vertices = flat.vertices.copy()
    over = vertices[:, 0] > 0
    vertices[over, 0] *= -1.0
    vertices[over, 2] += GAP_M
    return flat.with_vertices(vertices)


def test_layers_are_counted_from_above(folded):
    tip = np.array([-0.062, 0.001, 0.003])
    held = layers_under(folded, tip, 0.03)
    np.testing.assert_allclose(folded.vertices[held, 2], [GAP_M, 0.0])
    aside = np.linalg.norm(folded.vertices[held, :2] - tip[:2], axis=1)
    assert (aside < 0.005).all(), "the nearest vertex of each layer"


def test_what_is_out_of_reach_is_not_held(folded):
    tip = np.array([-0.062, 0.001, GAP_M + 0.006])
    held = layers_under(folded, tip, 0.008)
    np.testing.assert_allclose(folded.vertices[held, 2], [GAP_M])


def test_held_vertices_keep_their_offset_from_the_tip():
    path = PickerPath(np.array([0.0, 1.0]), np.array([[0.0, 0, 0], [0.1, 0, 0]]), np.full(2, True))
    grasp = Grasp("arm", path, np.array([3]), np.array([[0.0, 0.002, -0.01]]))
    points = grasp.waypoints(0.0, 1.0, np.array([0.0, 0.0, 0.001]))
    assert np.allclose(points[[0, -1], 0], [[0.0, 0.002, -0.009], [0.1, 0.002, -0.009]])
