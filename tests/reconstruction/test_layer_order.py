"""Pairs of layers against a search of every vertex and triangle, and their gaps."""

import numpy as np
import pytest
import seen_above as above

from clothtrack.garments.garment_meshes import towel
from clothtrack.reconstruction.layer_order import LayerOrder

GAP_M = 0.002


@pytest.fixture(scope="module")
def flat():
    return towel(0.2, 0.15, 0.0125)


@pytest.fixture(scope="module")
def folded(flat):
    """Two parallel creases: three layers, and no vertex that lies just over an edge."""
    folded = above.half_folded(flat, at_m=0.025)
    last = np.asarray(flat.vertices)[:, 0] > 0.075
    folded[last] = folded[last] * (-1.0, 1.0, 1.0) + (-0.05, 0.0, above.LAYER_M)
    jitter = np.random.default_rng(1).uniform(-0.002, 0.002, folded.shape)
    return folded + jitter * (1.0, 1.0, 0.0)


def barycentric(point, corners):
    sides = np.column_stack([corners[1] - corners[0], corners[2] - corners[0]])
    second, third = np.linalg.solve(sides, point - corners[0])
    return np.array([1.0 - second - third, second, third])


def overlaps(mesh, vertices):
    """Vertex, triangle and shares of its corners of all that lie on each other, one by one."""
    joined = {tuple(edge) for edge in mesh.edges} | {tuple(edge[::-1]) for edge in mesh.edges}
    for vertex in range(mesh.vertex_count):
        for face in mesh.faces:
            if vertex in face or any((vertex, corner) in joined for corner in face):
                continue
            blend = barycentric(vertices[vertex, :2], vertices[face, :2])
            if (blend >= 0.0).all():
                yield vertex, face, blend


def rows_of(mesh, vertices, order_m):
    """How high the upper layer of each pair lies over the lower one, as a matrix of heights."""
    rows = []
    for vertex, face, blend in overlaps(mesh, vertices):
        row = np.zeros(mesh.vertex_count)
        row[vertex], row[face] = 1.0, -blend
        rows.append(np.sign(row @ order_m) * row)
    return np.array(rows)


@pytest.fixture(scope="module")
def rows(flat, folded):
    return rows_of(flat, folded, folded[:, 2])


def found(flat, folded, order_m, **options):
    layers = LayerOrder(flat)
    layers.find(folded, order_m, **options)
    return layers


@pytest.mark.parametrize("order", [1.0, -1.0])
def test_layers_come_to_lie_a_gap_apart_in_their_order(flat, folded, rows, rng, order):
    layers = found(flat, folded, order * folded[:, 2])
    heights = layers.apart(rng.uniform(0.0, 0.004, flat.vertex_count), GAP_M, 3000)
    assert len(rows) > 150
    assert (order * (rows @ heights)).min() > 0.98 * GAP_M
    # What is apart is left alone.
    apart = order * folded[:, 2]
    assert (order * (rows @ apart)).min() > GAP_M
    np.testing.assert_array_equal(layers.apart(apart, GAP_M, 5), apart)


@pytest.mark.parametrize("votes", [1, 4])
def test_one_vertex_that_says_otherwise_is_outvoted(flat, folded, rows, rng, votes):
    order_m = folded[:, 2].copy()
    x, y = folded[:, :2].T
    top = order_m > 2.5 * above.LAYER_M
    order_m[np.argmin(np.where(top, np.hypot(x + 0.012, y), np.inf))] = 0.0
    heights = rng.uniform(0.0, 0.004, flat.vertex_count)
    right = found(flat, folded, folded[:, 2]).apart(heights, GAP_M, 5)
    said = found(flat, folded, order_m, votes=votes).apart(heights, GAP_M, 5)
    np.testing.assert_allclose(said, right, atol=1e-12)
