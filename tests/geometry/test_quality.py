"""Quality measures against closed forms and all pairs."""

import itertools

import numpy as np
import pytest

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import (
    CrossingCheck,
    below,
    close_pairs,
    crossing_edges,
    crossings,
    edge_strain,
)


def grid(count, size):
    side = np.linspace(-size / 2, size / 2, count)
    x, y = np.meshgrid(side, side, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    one = np.stack([corner, corner + count, corner + 1], 1)
    other = np.stack([corner + 1, corner + count, corner + count + 1], 1)
    return vertices, np.concatenate([one, other])


def test_strain_of_a_scaled_cloth_is_the_scale_less_one():
    vertices, faces = grid(6, 0.3)
    mesh = ClothMesh(vertices, faces)
    assert edge_strain(mesh, vertices) == 0
    assert edge_strain(mesh, 1.07 * vertices + 2.0) == pytest.approx(0.07)
    assert edge_strain(mesh, 0.93 * vertices) == pytest.approx(0.07)


def brute_crossings(vertices, faces):
    """Edges through triangles by solving for the meeting point of each pair."""
    edges = {tuple(sorted(pair)) for face in faces for pair in itertools.combinations(face, 2)}
    found = 0
    for edge in edges:
        p, q = vertices[list(edge)]
        for face in faces:
            if set(edge) & set(face.tolist()):
                continue
            a, b, c = vertices[face]
            system = np.stack([q - p, a - b, a - c], 1)
            if np.linalg.det(system) == 0:  # parallel
                continue
            t, u, v = np.linalg.solve(system, a - p)
            if 0 < t < 1 and u > 0 and v > 0 and u + v < 1:
                found += 1
                break
    return found


@pytest.mark.parametrize("seed", range(3))
def test_crossings_agree_with_all_pairs(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = grid(6, 1.0)
    vertices = vertices + rng.normal(scale=0.25, size=vertices.shape)
    expected = brute_crossings(vertices, faces)
    assert expected > 10
    assert crossings(vertices, faces) == expected


def test_a_check_of_moving_vertices_finds_what_a_new_one_finds():
    rng = np.random.default_rng(5)
    vertices, faces = grid(8, 0.1)
    check = CrossingCheck(faces)
    for spread in (0.0, 0.03, 0.01, 0.0):
        moved = vertices + rng.normal(scale=spread, size=vertices.shape)
        for found, anew in zip(check(moved), crossing_edges(moved, faces), strict=True):
            np.testing.assert_array_equal(found, anew)
            assert bool(len(found)) == (spread > 0.0)
    moved[3] = np.nan
    assert len(check(moved)[0]) == crossings(moved, faces)


def test_a_vertex_that_is_nowhere_crosses_nothing():
    rng = np.random.default_rng(3)
    vertices, faces = grid(6, 1.0)
    vertices = vertices + rng.normal(scale=0.25, size=vertices.shape)
    lost = vertices.copy()
    lost[7] = np.nan
    whole = faces[(faces != 7).all(axis=1)]
    assert crossings(lost, faces) == crossings(vertices, whole) > 0
    assert crossings(np.full_like(vertices, np.nan), faces) == 0


def test_close_pairs_agree_with_a_walk_over_the_mesh():
    rng = np.random.default_rng(2)
    vertices, faces = grid(7, 0.1)
    vertices = vertices + rng.normal(scale=0.02, size=vertices.shape)
    joined = np.zeros((49, 49), bool)
    for a, b in itertools.permutations(range(3), 2):
        joined[faces[:, a], faces[:, b]] = True
    near = joined | ((joined.astype(int) @ joined.astype(int)) > 0)
    distances = np.linalg.norm(vertices[:, None] - vertices[None], axis=-1)
    expected = int(np.triu((distances <= 0.02) & ~near, 1).sum())
    assert expected > 3
    assert close_pairs(vertices, faces, 0.02) == expected


def test_below_is_a_share_with_a_tolerance():
    heights = np.array([0.0, 0.001, -0.001, -0.0021, -0.5])
    assert below(heights, resting_height_m=0.001) == pytest.approx(2 / 5)
    assert below(heights, resting_height_m=0.001, tolerance_m=1.0) == 0
