import numpy as np
import pytest

from clothtrack.garments.garment_meshes import garment
from clothtrack.report.layers import Layers

TOWEL = garment("towel", vertex_count=400, size_m=(0.3, 0.3))
UP = np.array([0.0, 0.0, 1.0])


def zigzag(vertices, *, leaves):
    """A sheet folded over `leaves` - 1 times, its leaves 1 cm apart, vertex on vertex."""
    x, y, _ = np.asarray(vertices).T
    width = 0.3 / leaves
    leaf = np.clip((x + 0.15) // width, 0, leaves - 1)
    along = (x + 0.15) - leaf * width
    along = np.where(leaf % 2 == 0, along, width - along)
    return np.column_stack([along, y, 0.01 * leaf]), leaf


def inner(vertices, leaves):
    """Vertices whose whole neighborhood lies on one leaf."""
    x = np.asarray(vertices)[:, 0] + 0.15
    to_fold = np.abs(x[:, None] - np.arange(leaves + 1) * 0.3 / leaves).min(axis=1)
    return (to_fold > 0.03) & (np.abs(np.asarray(vertices)[:, 1]) < 0.12)


@pytest.mark.parametrize("leaves", [1, 2, 3])
def test_a_vertex_counts_the_leaves_under_it(leaves):
    vertices, leaf = zigzag(TOWEL.vertices, leaves=leaves)
    chosen = inner(TOWEL.vertices, leaves)
    assert chosen.sum() > 20
    counts = Layers(TOWEL, UP).counts(vertices)
    np.testing.assert_array_equal(counts[chosen], leaf[chosen])


def test_against_every_triangle_one_by_one(rng):
    """The same count as the definition: rays down from every vertex through every triangle."""
    mesh = garment("towel", vertex_count=60, size_m=(0.2, 0.2))
    vertices = mesh.vertices + rng.normal(0, 0.04, mesh.vertices.shape)
    expected = np.zeros(mesh.vertex_count)
    for number, vertex in enumerate(vertices):
        for face in mesh.faces:
            if number in face:
                continue
            a, b, c = vertices[face]
            system = np.array([[*p[:2], 1.0] for p in (a, b, c)]).T
            weights = np.linalg.solve(system, [*vertex[:2], 1.0])
            if (weights > 0).all() and weights @ [a[2], b[2], c[2]] < vertex[2]:
                expected[number] += 1
    counts = Layers(mesh, UP).counts(vertices)
    assert (counts == expected).mean() > 0.9  # the rest is a step aside across an edge
    assert np.abs(counts - expected).max() <= 2
    assert expected.max() >= 2
