"""Where a mesh contradicts its cloud: nothing for the right one, the distance where it is moved."""

import numpy as np
import pytest

from clothtrack.evaluation.local_misfit import local_misfit
from clothtrack.evaluation.places import place_of
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.closest_point import distance_to_mesh
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import Observation, thin

CAMERA = Camera(
    "above", 320, 240, 300.0, 300.0, 159.5, 119.5,
    np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.8], [0, 0, 0, 1]]),
)  # fmt: skip
SIDE = 21


def sheet(spacing=0.015):
    """A flat cloth of 0.3 m, seen from above."""
    grid = spacing * (np.arange(SIDE) - SIDE // 2)
    x, y = np.meshgrid(grid, grid)
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.01)], axis=1)
    at = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = at[:-1, :-1].ravel(), at[:-1, 1:].ravel(), at[1:, :-1].ravel(), at[1:, 1:].ravel()
    return ClothMesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]))


def seen(low=(-0.15, -0.15), high=(0.15, 0.15)):
    """A dense cloud of a flat rectangle."""
    x, y = np.meshgrid(*(np.arange(a, b, 0.002) for a, b in zip(low, high, strict=True)))
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.01)], axis=1)
    return Observation(points, (CAMERA,), {}, None, np.zeros((0, 3)), 0.0)


def misfit(vertices, observation):
    mesh = sheet()
    cloud = thin(observation.points, 0.004)
    away = distance_to_mesh(cloud, vertices, mesh.faces)
    return local_misfit(mesh, vertices, observation, cloud, away)


def test_a_mesh_that_lies_where_the_cloth_is_seen_contradicts_nothing():
    found = misfit(sheet().vertices, seen())
    assert found.patch_m.max() < 0.004


def test_cloth_outside_of_the_mesh_is_found_where_it_is_and_as_far_as_it_is():
    found = misfit(sheet().vertices, seen(high=(0.18, 0.15)))
    right = sheet().vertices[:, 0] > 0.149
    assert found.uncovered_m.max() == pytest.approx(0.03, abs=0.004)
    assert found.uncovered_m[right].mean() > 0.02
    assert found.uncovered_m[~right].max() < 0.004
    assert found.patch_m[sheet().vertices[:, 0] < 0.08].max() < 0.004


def test_mesh_outside_of_the_cloth_is_found_where_it_is():
    found = misfit(sheet().vertices, seen(low=(-0.12, -0.15)))
    left = sheet().vertices[:, 0] < -0.149
    assert found.unsupported_m[left].mean() == pytest.approx(0.03, abs=0.006)
    assert found.unsupported_m[sheet().vertices[:, 0] > -0.1].max() < 0.004


def test_a_part_that_floats_above_its_points_is_found_by_its_distance():
    vertices = sheet().vertices.copy()
    corner = (vertices[:, 0] > 0.05) & (vertices[:, 1] > 0.05)
    vertices[corner, 2] += 0.02
    found = misfit(vertices, seen())
    inner = (vertices[:, 0] > 0.09) & (vertices[:, 1] > 0.09)
    assert np.nanmean(found.surface_m[inner]) == pytest.approx(0.02, abs=0.004)
    assert found.patch_m[inner].min() > 0.015
    assert found.patch_m[(vertices[:, 0] < 0) & (vertices[:, 1] < 0)].max() < 0.004


def test_what_could_not_be_seen_contradicts_nothing():
    observation = seen(high=(0.1, 0.15))
    hidden = np.zeros((240, 320), bool)
    hidden[:, int(159.5 + 300 * 0.1 / 0.79) - 2 :] = True
    blind = Observation(
        observation.points, (CAMERA,), {"above": hidden}, None, np.zeros((0, 3)), 0.0
    )
    assert misfit(sheet().vertices, observation).patch_m.max() > 0.02
    assert misfit(sheet().vertices, blind).patch_m.max() < 0.004


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (lambda v: v[:, 0] > 0.12, "at the right"),
        (lambda v: (v[:, 0] < -0.12) & (v[:, 1] > 0.12), "at the top left"),
        (lambda v: np.abs(v).max(axis=1) < 0.05, "in the middle"),
    ],
)
def test_a_part_is_named_as_it_lies_in_the_picture(part, words):
    vertices = sheet().vertices
    assert place_of(vertices, part(vertices), (CAMERA,)) == words
