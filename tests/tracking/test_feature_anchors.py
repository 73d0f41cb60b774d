"""Followed points hold on to their material points, and nothing else."""

from dataclasses import dataclass

import numpy as np
import pytest

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import FollowedPoints, Observation
from clothtrack.tracking.feature_anchors import DOUBT_M, NEAR_M, FeatureAnchors

SQUARE = ClothMesh(
    np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]),
    np.array([[0, 1, 2], [0, 2, 3]]),
)


@dataclass(frozen=True)
class Lying:
    positions: np.ndarray


def seen(points, numbers=None):
    points = np.array(points, float).reshape(-1, 3)
    followed = FollowedPoints(
        np.arange(len(points)) if numbers is None else np.array(numbers), points
    )
    return Observation(points, (), {}, None, np.zeros((0, 3)), 0.0, followed)


@pytest.fixture
def marks():
    return FeatureAnchors(SQUARE, lambda positions: np.ones(len(positions), bool))


def bind(marks, observation, positions=SQUARE.vertices):
    marks.bind(Lying(positions[None]), observation)


def test_a_point_wants_its_material_point_where_it_is_now(marks):
    bind(marks, seen([[0.09, 0.03, 0.001]]))
    wanted = marks(SQUARE.vertices, seen([[0.10, 0.02, 0.0]]))
    # In the triangle (0, 0), (0.1, 0), (0.1, 0.1): shares 0.1, 0.6 and 0.3.
    trust = 1.0 / (1.0 + 2e-4 / DOUBT_M**2) ** 2
    np.testing.assert_allclose(wanted.weight, trust * np.array([0.1, 0.6, 0.3, 0.0]), atol=1e-9)
    np.testing.assert_allclose(wanted.wanted[:3], SQUARE.vertices[:3] + [0.01, -0.01, 0.0])
    np.testing.assert_array_equal(wanted.wanted[3], SQUARE.vertices[3])


def test_what_lies_beside_the_mesh_or_on_hidden_cloth_is_not_bound():
    hidden = FeatureAnchors(SQUARE, lambda positions: np.array([True, True, True, False]))
    bind(hidden, seen([[0.02, 0.07, 0.0], [0.07, 0.02, 0.0], [0.07, 0.02, 1.5 * NEAR_M]]))
    wanted = hidden(SQUARE.vertices, seen([[0.02, 0.07, 0], [0.07, 0.02, 0], [0.07, 0.02, 0.01]]))
    assert wanted.weight.sum() == pytest.approx(1.0)
    assert wanted.weight[3] == 0.0


def test_a_point_stays_bound_and_is_so_when_it_comes_back(marks):
    bind(marks, seen([[0.05, 0.02, 0.0]], numbers=[4]))
    slid = SQUARE.vertices + [0.003, 0.0, 0.0]
    bind(marks, seen([[0.05, 0.02, 0.0], [0.08, 0.02, 0.0]], numbers=[4, 7]), slid)
    old = marks(slid, seen([[0.05, 0.02, 0.0]], numbers=[4]))
    np.testing.assert_allclose(
        old.wanted[old.weight > 0] - slid[old.weight > 0], [[-0.003, 0, 0]] * 3, atol=1e-12
    )
    new = marks(slid, seen([[0.08, 0.02, 0.0]], numbers=[7]))
    np.testing.assert_allclose(new.wanted, slid, atol=1e-12)
    bind(marks, seen([[0.08, 0.02, 0.0]], numbers=[7]), slid)
    back = marks(slid, seen([[0.05, 0.02, 0.0]], numbers=[4]))
    np.testing.assert_array_equal(back.wanted, old.wanted)
