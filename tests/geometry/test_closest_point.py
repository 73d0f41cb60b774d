"""Closest points agree with brute force and with what can be said in closed form."""

import numpy as np
import pytest

from clothtrack.geometry.closest_point import (
    closest_on_mesh,
    closest_on_triangle,
)


def soup(rng, count):
    vertices = rng.normal(size=(3 * count, 3))
    return vertices, np.arange(3 * count).reshape(-1, 3)


def dense_samples(corners, steps=200):
    u, v = np.meshgrid(np.linspace(0, 1, steps), np.linspace(0, 1, steps))
    keep = u + v <= 1
    weights = np.stack([1 - u[keep] - v[keep], u[keep], v[keep]], axis=1)
    return weights @ corners


def test_no_sample_of_the_triangle_is_closer(rng):
    corners = rng.normal(size=(40, 3, 3))
    points = 2 * rng.normal(size=(40, 3))
    weights = closest_on_triangle(points, corners)
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    found = np.linalg.norm(np.einsum("ij,ijk->ik", weights, corners) - points, axis=1)
    for triangle, point, distance in zip(corners, points, found, strict=True):
        sampled = np.linalg.norm(dense_samples(triangle) - point, axis=1).min()
        assert distance <= sampled + 1e-12
        assert distance >= sampled - 0.05  # the samples are this dense


def test_a_triangle_without_area_is_its_longest_edge():
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0]]])
    weights = closest_on_triangle(np.array([[0.25, 1.0, 0.0]]), corners)
    np.testing.assert_allclose(weights[0] @ corners[0], [0.25, 0, 0], atol=1e-12)


@pytest.mark.parametrize("away_m", [0.0, 800.0])
def test_the_mesh_search_agrees_with_trying_every_face(rng, away_m):
    vertices, faces = soup(rng, 25)
    # Far from the origin single precision has steps of 6e-5.
    points, vertices = 1.5 * rng.normal(size=(200, 3)) + away_m, vertices + away_m
    face, weights = closest_on_mesh(points, vertices, faces)
    found = np.linalg.norm(np.einsum("ij,ijk->ik", weights, vertices[faces[face]]) - points, axis=1)
    for point, distance in zip(points, found, strict=True):
        every = closest_on_triangle(np.repeat(point[None], len(faces), 0), vertices[faces])
        gaps = np.linalg.norm(np.einsum("ij,ijk->ik", every, vertices[faces]) - point, axis=1)
        assert distance == pytest.approx(gaps.min(), abs=1e-6)
