"""Contours of a mesh with itself, against closed forms and differences."""

import numpy as np
import pytest

from clothtrack.geometry.intersections import SelfIntersection
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import crossing_edges


def sheet(count, side, *, shift=(0.0, 0.0, 0.0), turn=None):
    line = np.linspace(-side / 2, side / 2, count)
    x, y = np.meshgrid(line, line, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    one = np.stack([corner, corner + count, corner + 1], 1)
    other = np.stack([corner + 1, corner + count, corner + count + 1], 1)
    vertices = vertices if turn is None else vertices @ turn.T
    return vertices + np.array(shift), np.concatenate([one, other])


def about_x(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def joined(*sheets):
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in sheets])
    return ClothMesh(
        np.concatenate([vertices for vertices, _ in sheets]),
        np.concatenate([f + o for (_, f), o in zip(sheets, offsets, strict=False)]),
    )


def contour_length(mesh, vertices):
    """Length of all lines in which two triangles without a common vertex cut each other [m]."""
    found = SelfIntersection(mesh).contours(vertices)
    beside = SelfIntersection(mesh).edge_faces[found.edges]
    ends = vertices[mesh.edges[found.edges]].astype(np.float64)
    points = ends[:, 0] + found.along[:, None] * (ends[:, 1] - ends[:, 0])
    pairs = {}
    for number in range(len(found)):
        for face in beside[number]:
            if face >= 0:
                pair = tuple(sorted((int(face), int(found.faces[number]))))
                pairs.setdefault(pair, []).append(points[number])
    return sum(np.linalg.norm(two[0] - two[1]) for two in pairs.values() if len(two) == 2)


@pytest.mark.parametrize("seed", range(3))
def test_every_pair_is_listed(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = sheet(7, 1.0)
    vertices = (vertices + rng.normal(scale=0.25, size=vertices.shape)).astype(np.float32)
    search = SelfIntersection(ClothMesh(vertices, faces))
    edges, passed = search.pairs(vertices)
    expected, triangles = crossing_edges(vertices, faces)
    assert len(expected) > 10
    np.testing.assert_array_equal(search.edges[np.unique(edges)], expected)
    np.testing.assert_array_equal(search.mesh.faces[np.unique(passed)], triangles)


def test_a_place_on_the_edge_is_the_place_in_the_triangle():
    mesh = joined(sheet(5, 1.0), sheet(6, 0.8, shift=(0.03, 0.02, 0.1), turn=about_x(0.7)))
    found = SelfIntersection(mesh).contours(mesh.vertices)
    ends = mesh.vertices[mesh.edges[found.edges]]
    on_edges = ends[:, 0] + found.along[:, None] * (ends[:, 1] - ends[:, 0])
    within = np.einsum("ck,cki->ci", found.within, mesh.vertices[mesh.faces[found.faces]])
    np.testing.assert_allclose(on_edges, within, atol=1e-6)


def test_the_shortening_is_the_derivative_of_the_length():
    """Two single triangles, so that one moves against the other as a whole."""
    one = np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [0.2, 0.9, 0.1]])
    two = np.array([[0.3, 0.2, -0.4], [0.5, 0.4, 0.6], [0.9, 1.1, -0.5]])
    mesh = ClothMesh(np.concatenate([one, two]), np.array([[0, 1, 2], [3, 4, 5]]))
    found = SelfIntersection(mesh).contours(mesh.vertices)
    assert len(found) == 2
    # An edge of the second triangle moves with it, one of the first against it.
    of_second = np.where(found.faces == 0, 1.0, -1.0)
    predicted = -0.5 * (of_second[:, None] * found.shortening).sum(axis=0)
    measured = []
    for axis in np.eye(3):
        ahead, behind = (
            contour_length(mesh, mesh.vertices + sign * 1e-3 * np.repeat([0 * axis, axis], 3, 0))
            for sign in (1.0, -1.0)
        )
        measured.append((ahead - behind) / 2e-3)
    np.testing.assert_allclose(predicted, measured, atol=2e-3)
    assert np.abs(measured).max() > 0.1


def test_two_places_are_two_contours_each_with_two_sheets():
    """A sheet that dips twice through another."""
    vertices, faces = sheet(41, 1.0, shift=(0.004, 0.003, 0.0))
    for center in (-0.25, 0.25):
        away = np.square(vertices[:, :2] - (center, 0.01)).sum(axis=1)
        vertices[:, 2] += 0.1 * np.exp(-away / 0.1**2)
    vertices[:, 2] -= 0.05
    mesh = joined(sheet(31, 1.2), (vertices, faces))
    found = SelfIntersection(mesh).contours(mesh.vertices)
    assert found.count == 2
    lower = mesh.edges[found.edges][:, 0] < 31 * 31
    for contour in range(2):
        there = found.contour == contour
        assert set(found.sides[there]) == {-1, 1}
        assert len({*found.sides[there & lower]}) == len({*found.sides[there & ~lower]}) == 1
