import numpy as np
import pytest
from scipy.spatial.distance import cdist

from clothtrack.alignment.cloud_distance import within_reach


@pytest.mark.parametrize("reach_m", [0.03, 0.05, 0.2])
def test_points_within_reach_are_those_of_all_distances(reach_m):
    rng = np.random.default_rng(0)
    vertices = rng.uniform(-0.2, 0.2, (60, 3))
    points = rng.uniform(-0.4, 0.4, (800, 3))
    near = cdist(points, vertices).min(axis=1) <= reach_m
    assert 0 < near.sum() < len(points)
    np.testing.assert_array_equal(within_reach(points, vertices, reach_m), points[near])


def test_nothing_is_within_reach_of_nothing():
    points = np.zeros((4, 3))
    assert not len(within_reach(points, points[:0], 0.1))
    assert not len(within_reach(points[:0], points, 0.1))
