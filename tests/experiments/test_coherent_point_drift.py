"""The model-free peer: edges, held vertices, and drift onto a moved cloud."""

import numpy as np
import pytest
from shared.coherent_point_drift import EdgeLengths, PeerConfig, drifted

from clothtrack.garments.garment_meshes import towel


@pytest.fixture(scope="module")
def cloth():
    return towel(0.2, 0.2, spacing_m=0.02)


def lengths(mesh, vertices):
    a, b = mesh.edges.T
    return np.linalg.norm(vertices[a] - vertices[b], axis=1) / mesh.edge_lengths


def test_edges_within_their_bounds_stay(cloth):
    vertices = cloth.vertices.astype(np.float64) * 0.97
    fixed = np.zeros(len(vertices), bool)
    same = EdgeLengths(cloth).project(vertices, fixed, lengths=(0.95, 1.0), sweeps=5)
    np.testing.assert_array_equal(same, vertices)


@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_edges_come_into_their_bounds_and_the_middle_stays(cloth, factor):
    vertices = cloth.vertices.astype(np.float64) * factor
    fixed = np.zeros(len(vertices), bool)
    moved = EdgeLengths(cloth).project(vertices, fixed, lengths=(0.95, 1.0), sweeps=300)
    ratios = lengths(cloth, moved)
    assert ratios.min() > 0.945
    assert ratios.max() < 1.005
    np.testing.assert_allclose(moved.mean(axis=0), vertices.mean(axis=0), atol=1e-9)


def test_fixed_vertices_stay_and_draw_the_others(cloth):
    vertices = cloth.vertices.astype(np.float64)
    fixed = np.zeros(len(vertices), bool)
    fixed[0] = True
    vertices[0] -= [0.02, 0.02, 0.0]
    assert lengths(cloth, vertices).max() > 1.9
    moved = EdgeLengths(cloth).project(vertices, fixed, lengths=(0.0, 1.0), sweeps=300)
    np.testing.assert_array_equal(moved[0], vertices[0])
    assert lengths(cloth, moved).max() < 1.1


def test_visible_vertices_drift_to_the_cloud_and_hidden_ones_go_along():
    pytest.importorskip("biocpd", reason="the extra [experiments] brings it")
    cloth = towel(0.2, 0.2, spacing_m=0.01)
    vertices = cloth.vertices.astype(np.float64)
    fine = towel(0.2, 0.2, spacing_m=0.005).vertices.astype(np.float64)
    shift = np.array([0.004, -0.003, 0.006])
    seen = np.hypot(*vertices[:, :2].T) > 0.03
    moved = drifted(vertices, seen, fine + shift, PeerConfig(modes=60))
    # Along the cloth only its outline says where it went.
    gap = moved - vertices - shift
    assert np.abs(gap[:, 2]).max() < 0.001
    assert np.linalg.norm(gap, axis=1).mean() < 0.5 * np.linalg.norm(shift)


def test_without_a_cloud_nothing_moves(cloth):
    vertices = cloth.vertices.astype(np.float64)
    seen = np.ones(len(vertices), bool)
    same = drifted(vertices, seen, np.zeros((3, 3)), PeerConfig())
    np.testing.assert_array_equal(same, vertices)
