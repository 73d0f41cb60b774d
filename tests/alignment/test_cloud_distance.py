import numpy as np
import pytest
from scipy.spatial.distance import cdist

from clothtrack.alignment.cloud_distance import beside, masked_chamfer, within_reach
from clothtrack.recordings.point_cloud import Observation


@pytest.mark.parametrize("reach_m", [0.03, 0.05, 0.2])
def test_points_within_reach_are_those_of_all_distances(reach_m):
    rng = np.random.default_rng(0)
    vertices = rng.uniform(-0.2, 0.2, (60, 3))
    points = rng.uniform(-0.4, 0.4, (800, 3))
    near = cdist(points, vertices).min(axis=1) <= reach_m
    assert 0 < near.sum() < len(points)
    np.testing.assert_array_equal(within_reach(points, vertices, reach_m), points[near])


@pytest.mark.parametrize("spread_m", [0.2, 50.0])
def test_what_is_beside_vertices_holds_all_points_within_reach(spread_m):
    rng = np.random.default_rng(1)
    vertices = rng.uniform(-spread_m, spread_m, (30, 3))
    points = rng.uniform(-0.3, 0.3, (2000, 3)) + vertices[rng.integers(30, size=2000)]
    points[:500] += 2.0 * spread_m
    kept = beside(points, vertices, 0.05)
    distance = cdist(points, vertices).min(axis=1)
    places = {tuple(point) for point in kept}
    assert all(tuple(point) in places for point in points[distance <= 0.05])
    assert spread_m > 1.0 or len(kept) < len(points) - 500
    assert not len(beside(points, vertices[:0], 0.05))


def test_what_could_not_be_seen_has_no_distance_to_the_cloud(camera):
    vertices = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]])
    seen = np.ones(2, dtype=bool)

    def chamfer(clearance_m):
        tool = vertices[1:]
        cloud = Observation(vertices[:1], (camera,), {}, None, tool, clearance_m)
        return masked_chamfer(vertices, seen, cloud)

    assert chamfer(0.0) == pytest.approx(0.5 * 0.05**2)
    assert chamfer(0.02) == 0.0
    assert chamfer(0.1) == 0.0
