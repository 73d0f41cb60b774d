"""Winding numbers against what they must be: spheres, sheets, solid angles."""

import numpy as np
import pytest
import trimesh

from clothtrack.garments.garment_meshes import garment
from clothtrack_lab.published_networks.winding import (
    WindingConfig,
    winding_numbers,
    winding_pool,
)


def solid_angle_sum(vertices, faces, points):
    """The definition: signed solid angles of all triangles, by Van Oosterom and Strackee."""
    a, b, c = np.moveaxis(vertices[faces][None] - points[:, None, None], 2, 0)
    lengths = [np.linalg.norm(one, axis=-1) for one in (a, b, c)]
    triple = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    la, lb, lc = lengths
    below = la * lb * lc
    below += np.einsum("pfi,pfi->pf", a, b) * lc
    below += np.einsum("pfi,pfi->pf", b, c) * la
    below += np.einsum("pfi,pfi->pf", c, a) * lb
    return (2.0 * np.arctan2(triple, below)).sum(axis=1) / (4.0 * np.pi)


def test_a_sphere_is_one_inside_and_zero_outside(rng):
    sphere = trimesh.creation.icosphere(3, radius=0.3)
    points = rng.uniform(-0.5, 0.5, (500, 3))
    radius = np.linalg.norm(points, axis=1)
    found = winding_numbers(sphere.vertices, sphere.faces, points)
    np.testing.assert_allclose(found[radius < 0.28], 1.0, atol=0.02)
    np.testing.assert_allclose(found[radius > 0.31], 0.0, atol=0.02)


def test_a_sheet_jumps_from_a_half_to_minus_a_half():
    mesh = garment("towel", vertex_count=200)
    above, below = winding_numbers(
        mesh.vertices, mesh.faces, np.array([[0.01, 0.01, 1e-4], [0.01, 0.01, -1e-4]])
    )
    assert abs(above - below) == pytest.approx(1.0, abs=0.02)
    assert abs(above) == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_the_field_of_a_garment_is_its_solid_angle(kind, rng):
    mesh = garment(kind, vertex_count=300)
    points = rng.uniform(-0.25, 0.25, (400, 3))
    expected = solid_angle_sum(mesh.canonical, mesh.faces, points)
    found = winding_numbers(mesh.canonical, mesh.faces, points)
    np.testing.assert_allclose(found, expected, atol=0.03)


def test_a_pool_is_seeded_and_as_near_as_wanted():
    sphere = trimesh.creation.icosphere(2, radius=0.3)
    vertices = sphere.vertices + 0.5
    config = WindingConfig(pool=4000, near_share=0.25, near_spread=0.001)
    pool = winding_pool(vertices, sphere.faces, config, seed=3)
    again = winding_pool(vertices, sphere.faces, config, seed=3)
    np.testing.assert_array_equal(pool.points, again.points)
    np.testing.assert_array_equal(pool.values, again.values)
    assert pool.points.min() >= 0.0
    assert pool.points.max() <= 1.0
    distance = np.abs(np.linalg.norm(pool.points - 0.5, axis=1) - 0.3)
    # A shell this thin holds 2 % of the volume.
    assert 0.25 < (distance < 0.012).mean() < 0.30
    first_half = (distance[:2000] < 0.012).mean()
    assert first_half == pytest.approx((distance < 0.012).mean(), abs=0.04)
