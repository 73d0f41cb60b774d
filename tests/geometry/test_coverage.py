"""Projected area: closed forms, an independent oracle, and invariants."""

import itertools

import numpy as np
import pytest

from clothtrack.geometry.coverage import projected_area


def join(*meshes):
    offset = np.cumsum([0] + [len(v) for v, _ in meshes[:-1]])
    faces = [f + o for (_, f), o in zip(meshes, offset, strict=True)]
    return np.concatenate([v for v, _ in meshes]), np.concatenate(faces)


def grid(columns, rows, size):
    x, y = np.meshgrid(np.linspace(0, size[0], columns), np.linspace(0, size[1], rows))
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    one = np.stack([corner, corner + 1, corner + columns], 1)
    other = np.stack([corner + 1, corner + columns + 1, corner + columns], 1)
    return vertices, np.concatenate([one, other])


def slab_area(triangles):
    """Union area by slabs between all abscissas where an edge ends or crosses another."""
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 2)
    events = [edges[..., 0].ravel()]
    p, r = edges[:, 0], edges[:, 1] - edges[:, 0]
    cross = r[:, None, 0] * r[None, :, 1] - r[:, None, 1] * r[None, :, 0]
    offset = p[None] - p[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (offset[..., 0] * r[None, :, 1] - offset[..., 1] * r[None, :, 0]) / cross
    valid = np.isfinite(t) & (t > 0) & (t < 1)
    events.append((p[:, None, 0] + t * r[:, None, 0])[valid])
    x = np.unique(np.concatenate(events))
    total = 0.0
    for left, right in itertools.pairwise(x):
        middle = 0.5 * (left + right)
        intervals = []
        for triangle in triangles:
            hits = []
            for a, b in ((0, 1), (1, 2), (2, 0)):
                (x0, y0), (x1, y1) = triangle[a], triangle[b]
                if (x0 - middle) * (x1 - middle) < 0:
                    hits.append(y0 + (middle - x0) / (x1 - x0) * (y1 - y0))
            if len(hits) == 2:
                intervals.append(sorted(hits))
        reached, length = -np.inf, 0.0
        for low, high in sorted(intervals):
            length += max(0.0, high - max(low, reached))
            reached = max(reached, high)
        total += length * (right - left)
    return total


def test_layers_that_coincide_exactly_count_once():
    vertices, faces = grid(8, 6, (0.7, 0.5))
    mirrored = faces[:, ::-1]
    both = join((vertices, faces), (vertices + np.array([0, 0, 0.01]), mirrored), (vertices, faces))
    assert projected_area(*both) == pytest.approx(0.35, rel=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_random_triangles_agree_with_slab_integration(seed):
    rng = np.random.default_rng(seed)
    triangles = rng.normal(size=(14, 1, 2)) + 0.7 * rng.normal(size=(14, 3, 2))
    vertices = np.concatenate([triangles.reshape(-1, 2), rng.normal(size=(42, 1))], 1)
    area = projected_area(vertices, np.arange(42).reshape(-1, 3))
    assert area == pytest.approx(slab_area(triangles), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_a_crumpled_mesh_agrees_with_slab_integration(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = grid(5, 5, (1.0, 1.0))
    vertices += rng.normal(scale=0.2, size=vertices.shape)
    area = projected_area(vertices, faces)
    assert area == pytest.approx(slab_area(vertices[faces][..., :2]), rel=1e-6)


def test_rotation_about_the_view_and_tilt_do_what_they_must():
    rng = np.random.default_rng(5)
    vertices, faces = grid(9, 9, (0.4, 0.4))
    vertices += rng.normal(scale=0.02, size=vertices.shape)
    area = projected_area(vertices, faces)
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
    assert projected_area(vertices @ turn.T + [3.0, -2.0, 1.0], faces) == pytest.approx(area)
    tilt = np.array([[1, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]])
    flat, flat_faces = grid(9, 9, (0.4, 0.4))
    assert projected_area(flat @ tilt.T, flat_faces) == pytest.approx(0.6 * 0.16, rel=1e-6)
    normal = tuple(tilt @ [0, 0, 1.0])
    assert projected_area(flat @ tilt.T, flat_faces, normal) == pytest.approx(0.16, rel=1e-6)
