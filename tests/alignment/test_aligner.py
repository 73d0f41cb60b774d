"""Test-time optimization against a double-precision oracle, all pairs and its own laws."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from scipy.optimize import check_grad
from scipy.spatial import cKDTree

from clothtrack.alignment.aligner import AlignmentConfig, CloudAligner, Marks
from clothtrack.alignment.solvers import ADAM_STEP_M
from clothtrack.alignment.terms_kernels import TABLE_WEIGHT, TWO_WAY_RANGE_M
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Table

PAPER = AlignmentConfig(two_way_weight=0.0, length_weight=0.0, marks_weight=0.0)
OURS = AlignmentConfig()
TABLE = Table(point=np.array([0.0, 0.0, 0.002]), normal=np.array([0.0, 0.6, 0.8]))


def sheet(count=14, size=0.14):
    side = np.linspace(-size / 2, size / 2, count)
    x, y = np.meshgrid(side, side, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(count**2)], 1)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    one = np.stack([corner, corner + count, corner + 1], 1)
    other = np.stack([corner + 1, corner + count, corner + count + 1], 1)
    return ClothMesh(vertices, np.concatenate([one, other]))


def scene(seed=0, shift=(0.006, -0.004, 0.003), points=400):
    """A wavy sheet with a hidden corner, and a cloud of where it really is."""
    rng = np.random.default_rng(seed)
    mesh = sheet()
    wave = 0.01 * np.sin(30 * mesh.vertices[:, :1]) * np.array([0, 0, 1.0])
    positions = mesh.vertices + wave + np.array([2.0, -1.0, 0.7])
    visible = (mesh.vertices[:, 0] < 0.03) | (mesh.vertices[:, 1] < 0.02)
    truth = positions + np.array(shift)
    chosen = rng.choice(np.flatnonzero(visible), points)
    cloud = truth[chosen] + rng.uniform(-0.005, 0.005, (points, 3)) * [1, 1, 0.2]
    return mesh, positions, cloud, visible


class Oracle:
    """The objective as its definition reads, in double precision, with k-d trees."""

    def __init__(
        self, mesh, config, positions, cloud, visible, *, table=None, rest=0.0, marks=None
    ):
        self.marks = marks
        self.mesh, self.config, self.positions, self.cloud = mesh, config, positions, cloud
        self.visible, self.table, self.rest = np.flatnonzero(visible), table, rest
        self.tree = cKDTree(cloud)

    def match(self, displacement):
        """Renew the correspondences at a displacement."""
        now = (self.positions + displacement)[self.visible]
        self.nearest = self.visible[cKDTree(now).query(self.cloud)[1]]
        distance, partner = self.tree.query(now)
        low, high = TWO_WAY_RANGE_M
        counts = (distance >= low) & (distance <= high)
        self.seekers, self.partner = self.visible[counts], partner[counts]

    def value_and_gradient(self, displacement):
        """Objective and gradient for the present correspondences."""
        config, edges = self.config, self.mesh.edges
        x, gradient = self.positions + displacement, np.zeros_like(self.positions)

        miss = x[self.nearest] - self.cloud
        value = config.chamfer_weight * (miss**2).sum(1).mean()
        part = 2 * config.chamfer_weight / len(miss) * miss
        np.add.at(gradient, self.nearest, part)
        if len(self.seekers):
            miss = x[self.seekers] - self.cloud[self.partner]
            value += config.two_way_weight * (miss**2).sum(1).mean()
            gradient[self.seekers] += 2 * config.two_way_weight / len(miss) * miss
        difference = displacement[edges[:, 0]] - displacement[edges[:, 1]]
        value += config.rigidity_weight * (difference**2).sum(1).mean()
        part = 2 * config.rigidity_weight / len(edges) * difference
        edge = x[edges[:, 0]] - x[edges[:, 1]]
        length = np.linalg.norm(edge, axis=1)
        stretch = length - self.mesh.edge_lengths
        value += config.length_weight * (stretch**2).mean()
        part += 2 * config.length_weight / len(edges) * (stretch / length)[:, None] * edge
        np.add.at(gradient, edges[:, 0], part)
        np.add.at(gradient, edges[:, 1], -part)
        if self.marks is not None:
            weight = config.marks_weight / len(self.cloud) * self.marks.weight
            miss = x - self.marks.wanted
            value += (weight * (miss**2).sum(1)).sum()
            gradient += 2 * weight[:, None] * miss
        if self.table is not None:
            depth = np.maximum(0.0, self.rest - self.table.heights(x))
            value += TABLE_WEIGHT * (depth**2).mean()
            gradient -= 2 * TABLE_WEIGHT / len(x) * depth[:, None] * self.table.normal
        return value, gradient

    def adam(self):
        """The paper's optimizer, as its publication reads."""
        d = np.zeros_like(self.positions)
        first, second, losses = np.zeros_like(d), np.zeros_like(d), []
        for t in range(1, self.config.iterations + 1):
            self.match(d)
            value, g = self.value_and_gradient(d)
            losses.append(value)
            first = 0.9 * first + 0.1 * g
            second = 0.999 * second + 0.001 * g**2
            root = np.sqrt(second / (1 - 0.999**t)) + 1e-8
            d = d - ADAM_STEP_M * first / (1 - 0.9**t) / root
        self.match(d)
        return d, np.array([*losses, self.value_and_gradient(d)[0]])


VARIANTS = {
    "paper": PAPER,
    "ours": OURS,
    "weights": replace(OURS, chamfer_weight=2.0, rigidity_weight=3.0, two_way_weight=0.5),
}


def some_marks(positions):
    """A third of the vertices is wanted a few millimeters from where it is."""
    rng = np.random.default_rng(3)
    weight = rng.uniform(0.1, 1.0, len(positions)) * (np.arange(len(positions)) % 3 == 0)
    return Marks(positions + rng.normal(scale=3e-3, size=positions.shape), weight)


@pytest.mark.parametrize("name", VARIANTS)
def test_the_oracle_s_gradient_is_its_finite_difference(name):
    mesh, positions, cloud, visible = scene()
    table = Table(positions.mean(0), TABLE.normal)
    oracle = Oracle(
        mesh, VARIANTS[name], positions, cloud, visible, table=table, rest=0.01,
        marks=some_marks(positions),
    )  # fmt: skip
    start = np.random.default_rng(1).normal(scale=2e-3, size=positions.shape)
    oracle.match(start)
    error = check_grad(
        lambda d: oracle.value_and_gradient(d.reshape(-1, 3))[0],
        lambda d: oracle.value_and_gradient(d.reshape(-1, 3))[1].ravel(),
        start.ravel(),
        epsilon=1e-6,
    )
    assert error < 1e-3 * np.linalg.norm(oracle.value_and_gradient(start)[1])


@pytest.mark.parametrize("name", VARIANTS)
def test_kernel_gradient_and_objective_are_the_oracle_s(name):
    config = VARIANTS[name]
    mesh, positions, cloud, visible = scene()
    table = Table(positions.mean(0), TABLE.normal)
    marks = some_marks(positions)
    oracle = Oracle(mesh, config, positions, cloud, visible, table=table, rest=0.01, marks=marks)
    displacement = np.random.default_rng(1).normal(scale=2e-3, size=positions.shape)
    oracle.match(displacement)
    value, gradient = oracle.value_and_gradient(displacement)
    loss, measured = CloudAligner(mesh, config).gradient(
        positions, displacement, cloud, visible, table=table, rest_height_m=0.01, marks=marks
    )
    assert loss == pytest.approx(value, rel=1e-5)
    np.testing.assert_allclose(measured, gradient, atol=2e-5 * np.abs(gradient).max())


@pytest.mark.parametrize("name", ["paper", "ours"])
def test_adam_follows_the_reference(name):
    config = replace(VARIANTS[name], iterations=101)
    mesh, positions, cloud, visible = scene()
    table = Table(positions.mean(0) - 0.012 * TABLE.normal, TABLE.normal)
    expected, losses = Oracle(
        mesh, config, positions, cloud, visible, table=table, rest=0.003
    ).adam()
    result = CloudAligner(mesh, config).align(
        positions, cloud, visible, table=table, rest_height_m=0.003
    )
    assert result.iterations == 101
    assert result.losses.shape == (102,)
    assert result.losses[0] == pytest.approx(losses[0], rel=1e-5)
    assert result.losses[-1] == pytest.approx(losses[-1], rel=5e-3)
    assert losses[-1] < 0.9 * losses[0]
    assert np.abs(result.corrections - expected).mean() < 0.1 * np.abs(expected).mean()
    assert sum(term[-1] for term in result.terms.values()) == pytest.approx(result.losses[-1])


@pytest.mark.parametrize("name", ["paper", "ours"])
def test_icp_reaches_what_adam_reaches_within_percents(name):
    config = VARIANTS[name]
    mesh, positions, cloud, visible = scene()
    adam = CloudAligner(mesh, config).align(positions, cloud, visible)
    few = replace(config, solver="icp", iterations=8)
    icp = CloudAligner(mesh, few).align(positions, cloud, visible)
    assert icp.losses[0] == pytest.approx(adam.losses[0], rel=1e-6)
    assert icp.losses[-1] < 1.05 * adam.losses[-1]
    assert icp.losses[-1] < 0.9 * icp.losses[0]


def test_a_shifted_cloth_seen_completely_is_put_back():
    """One point per vertex, a shift below half the spacing: the answer is the shift."""
    mesh = sheet()
    shift = np.array([0.003, -0.002, 0.004])
    visible = np.ones(mesh.vertex_count, bool)
    for config in (PAPER, replace(PAPER, solver="icp", iterations=8, icp_inner=60)):
        result = CloudAligner(mesh, config).align(mesh.vertices, mesh.vertices + shift, visible)
        np.testing.assert_allclose(result.corrections, np.tile(shift, (len(visible), 1)), atol=1e-4)
        assert result.losses[-1] < 1e-3 * result.losses[0]


@pytest.mark.parametrize("solver", ["adam", "icp"])
def test_only_marks_see_a_sheet_slide_along_itself(solver):
    """A sheet longer than the picture slides by 6 mm: followed points show it, depth does not."""
    mesh = sheet()
    truth = mesh.vertices + [0.006, 0.0, 0.0]
    inside = np.abs(mesh.vertices[:, 0]) < 0.05
    rng = np.random.default_rng(0)
    cloud = np.stack([*rng.uniform([-0.05, -0.07], [0.05, 0.07], (3000, 2)).T, np.zeros(3000)], 1)
    some = inside & (np.arange(len(truth)) % 4 == 0)
    marks = Marks(np.where(some[:, None], truth, 0.0), some.astype(float))
    aligner = CloudAligner(mesh, replace(OURS, solver=solver, iterations=400))
    off = []
    for seen in (None, marks):
        result = aligner.align(mesh.vertices, cloud, inside, marks=seen)
        moved = mesh.vertices + result.corrections
        off.append(np.linalg.norm(moved - truth, axis=1)[inside].mean())
        assert (result.terms["marks"][0] > 0) == (seen is not None)
    assert off[0] > 0.005
    assert off[1] < 0.5 * off[0]


def test_only_the_two_way_term_pulls_an_overhanging_edge_in():
    mesh = sheet()
    visible = np.ones(mesh.vertex_count, bool)
    cloud = mesh.vertices[mesh.vertices[:, 0] < 0.05]  # the cloth's right end is not there
    right = mesh.vertices[:, 0] > 0.06
    pulled = [
        CloudAligner(mesh, replace(PAPER, two_way_weight=weight)).align(
            mesh.vertices, cloud, visible
        )
        for weight in (0.0, 1.0)
    ]
    assert np.abs(pulled[0].corrections[right]).max() < 1e-4
    assert pulled[1].corrections[right, 0].max() < -0.005
    trusted = mesh.vertices[:, 0] < 0.05
    silent = CloudAligner(mesh, replace(PAPER, two_way_weight=1.0)).align(
        mesh.vertices, cloud, visible, trusted=trusted
    )
    assert silent.terms["two_way"][0] == 0.0


@pytest.mark.parametrize("solver", ["adam", "icp"])
def test_alignment_repeats_bit_for_bit_and_does_not_depend_on_where_the_world_begins(solver):
    mesh, positions, cloud, visible = scene()
    aligner = CloudAligner(mesh, replace(OURS, solver=solver, iterations=30))
    first = aligner.align(positions, cloud, visible)
    again = aligner.align(positions, cloud, visible)
    np.testing.assert_array_equal(first.corrections, again.corrections)
    np.testing.assert_array_equal(first.losses, again.losses)
    far = np.array([64.0, -32.0, 16.0])
    moved = aligner.align(positions + far, cloud + far, visible)
    np.testing.assert_allclose(moved.losses, first.losses, rtol=2e-2)


def test_nothing_to_align_to_is_a_result():
    mesh, positions, cloud, visible = scene()
    aligner = CloudAligner(mesh, PAPER)
    for result, reason in (
        (aligner.align(positions, cloud[:0], visible), "no points"),
        (aligner.align(positions, cloud, np.zeros_like(visible)), "no visible vertex"),
        (aligner.align(positions + np.nan, cloud, visible), "not finite"),
    ):
        assert result.reason == reason
        assert result.iterations == 0
        assert not result.corrections.any()


@pytest.mark.gpu
@pytest.mark.parametrize("solver", ["adam", "icp"])
def test_the_gpu_agrees_with_the_cpu(solver):
    if not wp.is_cuda_available():
        pytest.skip("no CUDA device")
    mesh, positions, cloud, visible = scene()
    config = replace(OURS, solver=solver, iterations={"adam": 200, "icp": 8}[solver])
    results = [
        CloudAligner(mesh, config, device=device).align(positions, cloud, visible)
        for device in ("cpu", "cuda:0", "cuda:0")
    ]
    np.testing.assert_array_equal(results[1].corrections, results[2].corrections)
    assert results[1].losses[0] == pytest.approx(results[0].losses[0], rel=1e-5)
    assert results[1].losses[-1] == pytest.approx(results[0].losses[-1], rel=5e-3)
