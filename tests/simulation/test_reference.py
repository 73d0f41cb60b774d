"""The kernels against plain NumPy, substep by substep."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Table
from clothtrack.simulation.parameters import ClothParameters, SolverConfig
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import Attachment, pull_rate

_spec = importlib.util.spec_from_file_location(
    "solver_reference", Path(__file__).with_name("reference.py")
)
solver_reference = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(solver_reference)

FLOOR = Table(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]))
SUBSTEP_S = 1e-3
PARAMETERS = ClothParameters(1e-5, 3.0, 0.4, 0.3)


def sheet(columns, rows, height=0.0):
    x, y = np.meshgrid(np.arange(columns) * 0.01, np.arange(rows) * 0.01, indexing="ij")
    a = (np.arange(columns - 1)[:, None] * rows + np.arange(rows - 1)).ravel()
    b, c, d = a + rows, a + rows + 1, a + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return ClothMesh(np.stack([x, y, np.full_like(x, height)], axis=-1).reshape(-1, 3), faces)


def two_layers(count, gap):
    lower = sheet(count, count, 0.0015)
    upper = lower.vertices + np.array([0.0031, 0.0017, gap])
    faces = np.concatenate([lower.faces, lower.faces + lower.vertex_count])
    return ClothMesh(np.concatenate([lower.vertices, upper]), faces)


def config(**changes):
    return SolverConfig(
        **{
            "table": FLOOR,
            "sleep_speed": 0.0,
            "speed_limit": 1e3,
            "substep_s": SUBSTEP_S,
            **changes,
        }
    )


def shaken(mesh, seed, amplitude=0.0006, speed=0.5):
    rng = np.random.default_rng(seed)
    positions = mesh.vertices + rng.normal(0.0, amplitude, mesh.vertices.shape)
    return positions, rng.normal(0.0, speed, mesh.vertices.shape)


def reference(mesh, settings, positions, velocities, **attached):
    return solver_reference.ReferenceCloth(
        mesh,
        settings,
        PARAMETERS,
        positions.astype(np.float32).astype(float),
        velocities.astype(np.float32).astype(float),
        attached.get("pull", np.zeros(len(positions))),
        attached.get("goals", np.zeros_like(positions)),
    )


def test_stretch_bend_table_and_attachment():
    mesh = sheet(6, 5, 0.0012)
    positions, velocities = shaken(mesh, seed=1)
    strength = np.zeros(mesh.vertex_count)
    strength[[0, 1]] = 1.0
    strength[[10, 17]] = 0.7
    goals = positions + np.array([0.001, 0.0, 0.004])
    settings = config()
    solver = ClothSolver(mesh, settings, parameters=PARAMETERS)
    solver.place(positions)
    solver.set_velocities(velocities)
    solver.step(2 * SUBSTEP_S, Attachment(goals[None], strength[None]))
    pull = np.where(strength < 1, pull_rate(strength, 2 * SUBSTEP_S), -1.0)
    oracle = reference(mesh, settings, positions, velocities, pull=pull, goals=goals)
    oracle.substep(SUBSTEP_S, 2)
    oracle.substep(SUBSTEP_S, 1)
    np.testing.assert_allclose(solver.positions[0], oracle.positions, atol=1e-7)
    np.testing.assert_allclose(solver.velocities[0], oracle.velocities, atol=1e-3)
    np.testing.assert_allclose(solver.positions[0, :2], goals[:2], atol=1e-7)


def test_sharp_creases_resist():
    mesh = sheet(3, 2, 1.0)
    positions = mesh.vertices.copy()
    folded = positions[:, 0] > 0.015
    positions[folded, 0] = 0.004
    positions[folded, 2] += 0.001
    # Layers that keep no distance touch nothing.
    settings = config(table=None, thickness_m=1e-9, contact_depth_m=1e-9, edge_contact=False)
    solver = ClothSolver(mesh, settings, parameters=PARAMETERS)
    solver.place(positions)
    solver.step(SUBSTEP_S)
    oracle = reference(mesh, settings, positions, np.zeros_like(positions))
    oracle.substep(SUBSTEP_S, 1)
    np.testing.assert_allclose(solver.positions[0], oracle.positions, atol=1e-6)


def test_edges_give_more_to_a_push_than_to_a_pull():
    mesh = sheet(4, 4, 1.0)
    parameters = ClothParameters(1e-2, 1e6, 0.4, 0.3)
    steps = {}
    for name, scale in (("pushed", 0.8), ("pulled", 1.2)):
        for buckling in (1.0, 20.0):
            settings = config(table=None, gravity=(0.0, 0.0, 0.0), buckling=buckling)
            solver = ClothSolver(mesh, settings, parameters=parameters)
            solver.place(mesh.vertices * (scale, 1.0, 1.0))
            solver.step(SUBSTEP_S)
            steps[name, buckling] = solver.positions[0]
            oracle = reference(mesh, settings, mesh.vertices * (scale, 1.0, 1.0), 0 * mesh.vertices)
            oracle.parameters = parameters
            oracle.substep(SUBSTEP_S, 1)
            np.testing.assert_allclose(solver.positions[0], oracle.positions, atol=1e-7)
    width = {key: np.ptp(found[:, 0]) / 0.03 for key, found in steps.items()}
    # The diagonals are pushed where the sheet is pulled, and the other way round: hence bounds.
    assert 1.2 - width["pulled", 20.0] > 0.8 * (1.2 - width["pulled", 1.0])
    assert 0.0 < width["pushed", 20.0] - 0.8 < 0.5 * (width["pushed", 1.0] - 0.8)


@pytest.mark.parametrize("push_out_speed", [0.05, 5.0])
def test_vertex_triangle_contact(push_out_speed):
    mesh = two_layers(5, gap=0.0025)
    positions, velocities = shaken(mesh, seed=2)
    settings = config(push_out_speed=push_out_speed, edge_contact=False)
    solver = ClothSolver(mesh, settings, parameters=PARAMETERS)
    solver.place(positions)
    solver.set_velocities(velocities)
    solver.step(SUBSTEP_S)
    memory = solver.save().contacts
    assert memory.counts.sum() > 20
    oracle = reference(mesh, settings, positions, velocities)
    oracle.pairs = [
        list(zip(sides[:count].tolist(), kept[:count].tolist(), strict=True))
        for sides, kept, count in zip(
            memory.sides[0], memory.distances[0], memory.counts[0], strict=True
        )
    ]
    oracle.substep(SUBSTEP_S, 1)
    np.testing.assert_allclose(solver.positions[0], oracle.positions, atol=2e-7)
    np.testing.assert_allclose(solver.velocities[0], oracle.velocities, atol=1e-3)
