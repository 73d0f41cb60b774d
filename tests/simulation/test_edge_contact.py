from dataclasses import replace

import numpy as np
import pytest

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
