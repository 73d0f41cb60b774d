"""Neighbors stay exact while everything moves: against a k-d tree in every iteration."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial import cKDTree

from clothtrack.alignment import nearest_kernels as kernels
from clothtrack.alignment.nearest import Matcher


@wp.kernel(enable_backward=False)
def place(
    target: wp.array(dtype=wp.vec3),
    recorded: wp.array(dtype=wp.vec3),
    grid: kernels.Grid,
    progress: kernels.Progress,
    positions: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    kernels.record_step(grid, progress, positions[i], target[i])
    wp.atomic_max(progress.next_stale, 0, wp.length(target[i] - recorded[i]))
    positions[i] = target[i]


def on_device(values):
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3, device="cpu")


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("step", [1e-4, 1e-3, 2e-2])
def test_matches_are_exact_in_every_iteration(seed, step):
    rng = np.random.default_rng(seed)
    where = rng.uniform([-0.2, -0.15, 0], [0.2, 0.15, 0.03], (300, 3)).astype(np.float32)
    cloud = rng.uniform([-0.25, -0.2, -0.02], [0.2, 0.15, 0.05], (500, 3)).astype(np.float32)
    cloud[:5] += np.float32(0.5)  # strays far away
    visible, trusted = rng.random(300) < 0.7, rng.random(300) < 0.5
    trusted &= visible
    positions, points = on_device(where), on_device(cloud)
    matcher = Matcher(
        points, positions, visible, trusted,
        spacing_m=0.012, range_m=(0.004, 0.03),
    )  # fmt: skip
    sums = wp.zeros((30, 6), dtype=wp.int64, device="cpu")
    members, seekers = np.flatnonzero(visible), np.flatnonzero(trusted)
    for iteration in range(30):
        if iteration in (3, 17):
            matcher.rebuild(positions)
        matcher.launch(positions, sums)
        now = positions.numpy().astype(np.float64)
        best, index = cKDTree(now[members]).query(cloud)
        nearest = matcher.nearest_vertices()
        assert visible[nearest].all()
        np.testing.assert_allclose(
            np.linalg.norm(now[nearest] - cloud, axis=1), best, rtol=1e-6, atol=1e-9
        )
        assert (nearest == members[index]).mean() > 0.99
        squares = sums.numpy()[iteration, 0] / kernels.FIXED_POINT_SQUARE
        assert squares == pytest.approx((best**2).sum(), rel=1e-5)

        counts = np.bincount(nearest, minlength=300)
        np.testing.assert_array_equal(matcher.pulled_count.numpy(), counts)
        total = np.zeros((300, 3))
        np.add.at(total, nearest, cloud)
        pulled = matcher.pulled_sum.numpy().reshape(300, 3) / kernels.FIXED_POINT_LENGTH
        np.testing.assert_allclose(pulled, total, atol=1e-7)

        distance, _ = cKDTree(cloud).query(now[seekers])
        counts = (distance >= 0.004) & (distance <= 0.03)
        partner = matcher.partners()
        edge = np.minimum(np.abs(distance - 0.004), np.abs(distance - 0.03)) < 1e-6
        np.testing.assert_array_equal((partner[seekers] >= 0)[~edge], counts[~edge])
        paired = seekers[partner[seekers] >= 0]
        np.testing.assert_allclose(
            np.linalg.norm(now[paired] - cloud[partner[paired]], axis=1),
            distance[partner[seekers] >= 0],
            rtol=1e-5,
        )
        assert (partner[~trusted] == -1).all()

        where = where + rng.normal(scale=step, size=where.shape).astype(np.float32)
        wp.launch(
            place,
            dim=300,
            inputs=[
                on_device(where), matcher.grid.recorded, matcher.grid.cells, matcher.progress,
                positions,
            ],
            device="cpu",
        )  # fmt: skip


def test_a_flat_grid_of_one_cell_and_coincident_points_work():
    where = np.zeros((4, 3))
    where[3] = [0.001, 0, 0]
    cloud = np.array([[0.0, 0, 0], [0.0009, 0, 0]])
    positions = on_device(where)
    matcher = Matcher(
        on_device(cloud), positions, np.ones(4, bool), np.ones(4, bool),
        spacing_m=0.01, range_m=(0.0, 0.03),
    )  # fmt: skip
    matcher.launch(positions, wp.zeros((1, 6), dtype=wp.int64, device="cpu"))
    np.testing.assert_array_equal(matcher.nearest_vertices(), [0, 3])  # ties: lowest index
    np.testing.assert_array_equal(matcher.partners(), [0, 0, 0, 1])
