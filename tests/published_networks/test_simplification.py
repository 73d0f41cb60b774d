import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel, tshirt
from clothtrack.geometry.mesh import ClothMesh
from clothtrack_lab.published_networks.simplification import (
    largest_piece,
    without_pinches,
    without_short_edges,
)


def characteristic(faces):
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return len(np.unique(faces)) - len(np.unique(sides, axis=0)) + len(faces)


@pytest.mark.parametrize("make", [towel, tshirt])
@pytest.mark.parametrize("shortest", [0.012, 0.03])
def test_collapsing_keeps_a_manifold_with_its_openings(make, shortest):
    mesh = make(0.4, 0.4, 0.01)
    vertices, faces = without_short_edges(mesh.canonical, mesh.faces, shortest)
    found = ClothMesh(vertices, faces)
    assert found.vertex_count < 0.7 * mesh.vertex_count
    assert characteristic(faces) == characteristic(mesh.faces)
    assert len(largest_piece(faces)) == len(faces)
    assert len(without_pinches(faces)) == len(faces)


def test_a_flat_sheet_stays_flat_and_keeps_its_area():
    mesh = towel(0.3, 0.3, 0.01)
    vertices, faces = without_short_edges(mesh.vertices, mesh.faces, 0.02)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()
    assert 0.5 * normals[:, 2].sum() == pytest.approx(0.09, rel=0.03)


def test_the_smaller_of_two_fans_goes():
    large = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]])
    small = np.array([[0, 5, 6]])
    np.testing.assert_array_equal(without_pinches(np.concatenate([small, large])), large)
