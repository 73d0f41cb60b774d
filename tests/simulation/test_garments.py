"""Garments: one piece of cloth with the right openings, even triangles, shared material points."""

from collections.abc import Callable

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import garment, shirt, towel
from clothtrack.garments.outlines import (
    ShirtOutline,
    draw_robe,
    draw_shirt,
    draw_sweater,
)
from clothtrack.geometry.mesh import ClothMesh


def boundary_loops(faces: np.ndarray) -> int:
    """Number of closed chains of edges that belong to one triangle only."""
    sides = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, index, counts = np.unique(
        np.sort(sides, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    following = dict(sides[counts[index.ravel()] == 1].tolist())
    loops = 0
    while following:
        start, vertex = following.popitem()
        loops += 1
        while vertex != start:
            vertex = following.pop(vertex)
    return loops


def euler_characteristic(mesh: ClothMesh) -> int:
    return mesh.vertex_count - len(mesh.edges) + len(mesh.faces)


def components(mesh: ClothMesh) -> int:
    label = np.arange(mesh.vertex_count)
    while True:
        lowest = label.copy()
        np.minimum.at(lowest, mesh.edges[:, 0], label[mesh.edges[:, 1]])
        np.minimum.at(lowest, mesh.edges[:, 1], label[mesh.edges[:, 0]])
        if (lowest == label).all():
            return len(np.unique(label))
        label = lowest


def smallest_angle_deg(mesh: ClothMesh) -> float:
    corners = mesh.vertices[mesh.faces]
    smallest = np.inf
    for k in range(3):
        u = corners[:, (k + 1) % 3] - corners[:, k]
        v = corners[:, (k + 2) % 3] - corners[:, k]
        cosine = (u * v).sum(axis=1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)
        smallest = min(smallest, float(np.degrees(np.arccos(cosine.max()))))
    return smallest


@pytest.mark.parametrize("draw", [draw_shirt, draw_sweater, draw_robe])
def test_an_open_front_joins_hem_and_neck(
    draw: Callable[[np.random.Generator], ShirtOutline],
) -> None:
    outline = draw(np.random.default_rng(3))
    closed = shirt(outline, 0.7, vertex_count=800)
    opened = shirt(outline, 0.7, vertex_count=800, open_front=True)
    assert components(opened) == 1
    assert boundary_loops(closed.faces) == 4
    assert boundary_loops(opened.faces) == 3
    assert euler_characteristic(opened) == 2 - 3
    np.testing.assert_allclose(np.ptp(opened.vertices, axis=0), np.ptp(closed.vertices, axis=0))
    middle = opened.vertices[np.abs(opened.vertices[:, 0]) < 1e-9]
    assert (middle[:, 2] > 0.0).sum() >= 10
    assert smallest_angle_deg(opened) > 15.0


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("count", [500, 1500])
def test_tshirt_is_a_sphere_with_four_holes(count: int, seed: int) -> None:
    mesh = garment("tshirt", vertex_count=count, seed=seed)
    assert components(mesh) == 1
    assert boundary_loops(mesh.faces) == 4
    assert euler_characteristic(mesh) == 2 - 4
    assert smallest_angle_deg(mesh) > 15.0


@pytest.mark.parametrize("pattern", ["alternating", "regular", "random"])
def test_towel_is_a_disk_of_the_asked_size(pattern: str) -> None:
    mesh = towel(0.4, 0.3, 0.012, pattern=pattern, seed=2)
    assert components(mesh) == 1
    assert boundary_loops(mesh.faces) == 1
    assert euler_characteristic(mesh) == 1
    assert np.isclose(mesh.vertex_areas.sum(), 0.4 * 0.3)
    assert smallest_angle_deg(mesh) > 15.0
    assert np.array_equal(mesh.canonical, mesh.vertices)


@pytest.mark.parametrize("spacing", [0.0, -0.01, 0.2])
def test_a_spacing_that_does_not_fit_is_refused(spacing: float) -> None:
    with pytest.raises(InvalidConfigError, match="spacing_m"):
        towel(0.3, 0.3, spacing)
