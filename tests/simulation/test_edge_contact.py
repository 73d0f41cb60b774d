from dataclasses import replace

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import tshirt
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.parameters import ClothParameters, SolverConfig
from clothtrack.simulation.solver import ClothSolver

CONFIG = SolverConfig(
    thickness_m=0.004, gravity=(0.0, 0.0, 0.0), damping=0.0, sleep_speed=0.0, substep_s=1e-3
)
STIFF = ClothParameters(bend_compliance=0.0, particle_friction=0.0)


def flat_mesh(vertices: np.ndarray, faces: np.ndarray) -> ClothMesh:
    return ClothMesh(vertices, faces, vertices)


def two_roofs(gap_m: float) -> ClothMesh:
    """Two roofs of two triangles, the upper one upside down and turned by 90 degrees.

    Their ridges cross in the middle; every vertex is centimeters from the other roof.
    """
    lower = np.array([[-0.03, 0, 0], [0.03, 0, 0], [0, 0.03, -0.02], [0, -0.03, -0.02]])
    upper = lower[:, [1, 0, 2]] * (1.0, 1.0, -1.0) + (0.0, 0.0, gap_m)
    faces = np.array([[0, 1, 2], [1, 0, 3], [4, 6, 5], [5, 7, 4]])
    return flat_mesh(np.concatenate([lower, upper]), faces)


def separation(solver: ClothSolver) -> float:
    """Height of the upper ridge over the lower one."""
    positions = solver.positions[0]
    return float(positions[4:6, 2].mean() - positions[0:2, 2].mean())


def approach(edge_contact: bool) -> ClothSolver:
    solver = ClothSolver(
        two_roofs(0.006), replace(CONFIG, edge_contact=edge_contact), parameters=STIFF
    )
    velocities = np.zeros((8, 3))
    velocities[4:, 2] = -0.5
    solver.set_velocities(velocities)
    solver.step(0.03)
    return solver


def test_ridges_stop_each_other_and_keep_their_momentum():
    solver = approach(True)
    assert separation(solver) > 0.001
    masses = solver._buffers.masses.numpy()
    momentum = masses @ solver.velocities[0]
    np.testing.assert_allclose(momentum, [0, 0, -0.5 * masses[4:].sum()], atol=2e-3 * masses.sum())


def test_every_bent_edge_at_an_edge_is_listed_with_it():
    mesh = tshirt(0.15, 0.13, 0.012)
    solver = ClothSolver(mesh)
    solver.step(1e-3)
    noise = np.random.default_rng(0).normal(scale=0.002, size=mesh.vertices.shape)
    solver.place(mesh.vertices * (0.9, 0.9, 0.5) + noise)
    edges = solver._contact._edges
    edges.find()
    assert not solver.contact_overflows.any()
    placed = solver.positions[0].astype(np.float64)
    start, along = placed[mesh.edges[:, 0]], np.diff(placed[mesh.edges], axis=1)[:, 0]
    normal = np.cross(along[:, None], along)
    square = (normal**2).sum(axis=2)
    between = start - start[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (np.cross(between, along) * normal).sum(axis=2) / square
        t = (np.cross(between, along[:, None]) * normal).sum(axis=2) / square
        gap = np.abs((between * normal).sum(axis=2)) / np.sqrt(square)
    lengths = (along**2).sum(axis=1)
    a, b, c = placed[mesh.faces].swapaxes(0, 1)
    unit = np.cross(b - a, c - a)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    beside = edges._sides.numpy()
    bent = (beside[:, 1] < 0) | ((unit[beside[:, 0]] * unit[beside[:, 1]]).sum(axis=1) < 0.939)
    near = (np.minimum(s, t) > 1e-4) & (np.maximum(s, t) < 1.0 - 1e-4)
    near &= (square > 0.00251 * lengths[:, None] * lengths) & (bent[:, None] | bent)
    near &= gap < 0.7 * solver.config.thickness_m - 1e-6
    near &= (mesh.edges[:, None, :, None] != mesh.edges[:, None]).all(axis=(2, 3))
    assert near.sum() > 100
    partners, counts = edges._partners.numpy()[0], edges._counts.numpy()[0]
    filled = np.arange(partners.shape[1]) < counts[:, None]
    found = np.zeros(near.shape, bool)
    found[np.nonzero(filled)[0], np.abs(partners[filled]) - 1] = True
    assert not (found & found.T).any()
    assert not (near & ~(found | found.T)).any()


@pytest.mark.parametrize("friction", [0.0, 0.7])
def test_what_edges_want_is_the_sum_over_all_pairs(friction):
    mesh = two_roofs(0.003)
    solver = ClothSolver(mesh, CONFIG, parameters=replace(STIFF, particle_friction=friction))
    solver.step(1e-3)
    buffers, contact = solver._buffers, solver._contact
    edges = contact._edges
    rng = np.random.default_rng(0)
    placed = two_roofs(0.001).vertices + rng.normal(scale=2e-4, size=mesh.vertices.shape)
    solver.place(placed)
    edges.find()
    before = placed - rng.normal(scale=2e-4, size=mesh.vertices.shape)
    buffers.start.assign(before[None].astype(np.float32))
    buffers.moves.zero_()
    buffers.stops.zero_()
    edges.push()
    # The ridges are edges 0-1 and 4-5; no other pair is near.
    a, b, c, d = placed[[0, 1, 4, 5]]
    normal = np.cross(b - a, d - c)
    shares = np.linalg.solve(np.stack([b - a, c - d, normal], axis=1), c - a)
    s, t = shares[:2]
    weights = np.array([1 - s, s, t - 1, -t])
    outward = normal / np.linalg.norm(normal)
    gap = weights @ placed[[0, 1, 4, 5]] @ outward
    outward, gap = np.sign(gap) * outward, abs(gap)
    inverse = 1.0 / buffers.masses.numpy()[[0, 1, 4, 5]]
    slip = weights @ (placed - before)[[0, 1, 4, 5]]
    slip -= slip @ outward * outward
    push = 0.5 * CONFIG.thickness_m - gap
    cut = min(1.0, friction * push / np.linalg.norm(slip)) * slip
    impulse = (push * outward - cut) / (weights**2 @ inverse)
    expected = (weights * inverse)[:, None] * impulse
    np.testing.assert_allclose(buffers.moves.numpy()[0, [0, 1, 4, 5]], expected, atol=1e-8)
    assert not buffers.moves.numpy()[0, [2, 3, 6, 7]].any()
