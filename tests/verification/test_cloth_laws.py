"""Laws of physics that the cloth obeys, each with the tolerance that its integrator explains."""

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Table
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.parameters import ClothParameters, SolverConfig
from clothtrack.simulation.picker_action import HeldMotion
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import Attachment

FLOOR = Table(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]))
UP = np.array([0.0, 0.0, 1.0])


def sheet(size, height=0.0, spacing=0.01):
    mesh = towel(size, size, spacing)
    return mesh.with_vertices(mesh.vertices + height * UP)


def two_layers(size=0.08, gap=0.003):
    """The upper layer lies off the lower one's lattice, as in a real garment."""
    lower = sheet(size, 0.0015)
    upper = lower.vertices + np.array([0.0031, 0.0017, gap])
    faces = np.concatenate([lower.faces, lower.faces + lower.vertex_count])
    return ClothMesh(np.concatenate([lower.vertices, upper]), faces)


def strip():
    """A strip of 5 x 30 cm that hangs from its upper edge, and who holds it."""
    flat = towel(0.05, 0.3, 0.01)
    mesh = flat.with_vertices(flat.vertices[:, [0, 2, 1]])
    held = mesh.vertices[:, 2] > 0.15 - 1e-6
    return mesh, Attachment(mesh.vertices[None].copy(), held[None].astype(float))


def masses(mesh, config):
    return mesh.vertex_areas * config.area_density


def test_free_fall():
    config = SolverConfig(damping=0.0, speed_limit=100.0)
    solver = ClothSolver(sheet(0.05, 1.0), config)
    solver.step(0.2)
    fallen = 1.0 - solver.positions[0, :, 2]
    np.testing.assert_allclose(fallen, 0.5 * 9.81 * 0.2**2, rtol=3e-3)  # first order in h
    np.testing.assert_allclose(solver.velocities[0, :, 2], -9.81 * 0.2, rtol=1e-4)


def test_drag_ends_in_the_terminal_speed():
    solver = ClothSolver(sheet(0.05, 1.0), SolverConfig(damping=20.0))
    solver.step(0.6)
    np.testing.assert_allclose(solver.velocities[0, :, 2], -9.81 / 20.0, rtol=5e-3)


def test_a_hanging_strip_sags_less_than_a_fifth_of_a_percent():
    mesh, attachment = strip()
    solver = ClothSolver(mesh, SolverConfig(damping=3.0))
    for _ in range(20):
        solver.step(0.05, attachment)
    sag = (mesh.vertices[:, 2].min() - solver.positions[0, :, 2].min()) / 0.3
    assert 0.0 < sag < 0.002


def test_a_compliant_strip_sags_as_its_springs_say():
    # The weight below a row is carried by its vertical edges and diagonals, whose share is at
    # most that of parallel springs: the sag lies between both bounds.
    mesh, attachment = strip()
    compliance = 0.2
    solver = ClothSolver(
        mesh, SolverConfig(damping=3.0), parameters=ClothParameters(stretch_compliance=compliance)
    )
    for _ in range(30):
        solver.step(0.05, attachment)
    sag = mesh.vertices[:, 2].min() - solver.positions[0, :, 2].min()
    weight = masses(mesh, solver.config).sum() * 9.81
    springs = 6 + 5 * 0.5  # six vertical edges; a diagonal has half the stiffness downwards
    mean_load = weight / 2.0
    assert sag == pytest.approx(30 * compliance * mean_load / springs, rel=0.15)


@pytest.mark.parametrize("friction", [0.3, 0.6])
def test_coulomb_threshold_on_a_tilted_table(friction):
    slopes = {}
    for slope in (0.85 * friction, 1.15 * friction):
        angle = np.arctan(slope)
        table = Table(np.zeros(3), np.array([np.sin(angle), 0.0, np.cos(angle)]))
        downhill = np.array([np.cos(angle), 0.0, -np.sin(angle)])
        flat = towel(0.04, 0.04, 0.01)
        across = np.array([0.0, 1.0, 0.0])
        lying = (
            flat.vertices[:, :1] * downhill + flat.vertices[:, 1:2] * across + 0.0015 * table.normal
        )
        # Without sleep: its threshold of speed would hold a cloth that starts to slide slowly.
        solver = ClothSolver(
            flat.with_vertices(lying),
            SolverConfig(table=table, sleep_speed=0.0, damping=0.0),
            parameters=ClothParameters(table_friction=friction),
        )
        solver.step(0.3)
        slopes[slope] = float(((solver.positions[0] - lying) @ downhill).mean())
        expected = 0.5 * 9.81 * (np.sin(angle) - friction * np.cos(angle)) * 0.3**2
        assert slopes[slope] == pytest.approx(max(expected, 0.0), rel=0.03, abs=1e-4)


def test_a_cloth_on_cloth_slides_by_particle_friction():
    # Two layers in free flight, one faster than the other: without pressure nothing changes.
    mesh = two_layers(gap=0.004)
    solver = ClothSolver(mesh, SolverConfig(gravity=(0.0, 0.0, 0.0), damping=0.0))
    velocities = np.zeros_like(mesh.vertices)
    velocities[mesh.vertex_count // 2 :, 0] = 0.1
    solver.set_velocities(velocities[None])
    solver.step(0.02)
    np.testing.assert_allclose(solver.velocities[0], velocities, atol=1e-4)


def test_a_collision_conserves_momentum():
    # One triangle falls on another; every vertex has the same number of touching pairs.
    corners = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.004, 0.009, 0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    mesh = ClothMesh(np.concatenate([corners, corners + 0.004 * UP]), faces)
    config = SolverConfig(gravity=(0.0, 0.0, 0.0), damping=0.0)
    solver = ClothSolver(mesh, config)
    velocities = np.zeros((1, 6, 3))
    velocities[0, 3:, 2] = -0.3
    velocities[0, 3:, 0] = 0.05
    solver.set_velocities(velocities)
    weights = masses(mesh, config)
    before = weights @ velocities[0]
    solver.step(0.05)
    after = solver.velocities[0]
    np.testing.assert_allclose(weights @ after, before, atol=1e-3 * np.abs(before).max())
    assert after[3:, 2].mean() - after[:3, 2].mean() > -0.02  # they no longer approach
    kinetic = 0.5 * weights @ (after**2).sum(axis=1)
    assert kinetic <= 0.5 * weights @ (velocities[0] ** 2).sum(axis=1) * (1 + 1e-5)


def test_two_layers_keep_their_gap():
    mesh = two_layers(gap=0.006)
    solver = ClothSolver(mesh, SolverConfig(table=FLOOR))
    for _ in range(10):
        solver.step(0.05)
    half = mesh.vertex_count // 2
    heights = solver.positions[0, :, 2]
    np.testing.assert_allclose(heights[:half], 0.0015, atol=2e-4)
    # The rim that overhangs the lower layer finds nothing under it and may droop.
    inner = (np.abs(mesh.vertices[half:, :2]) < 0.035).all(axis=1)
    np.testing.assert_allclose(heights[half:][inner], 0.0045, atol=2e-4)
    assert np.abs(solver.velocities).max() < 0.1


def test_a_layer_pushed_through_another_returns_to_its_side():
    mesh = two_layers(size=0.12)
    solver = ClothSolver(mesh, SolverConfig(table=FLOOR))
    solver.step(0.1)
    half = mesh.vertex_count // 2
    inner = half + np.flatnonzero((np.abs(mesh.vertices[half:, :2]) < 0.055).all(axis=1))
    rng = np.random.default_rng(7)
    pushed = rng.choice(inner, len(inner) // 2, replace=False)
    targets = solver.positions.astype(float)
    targets[0, pushed, 2] = 0.0015
    strength = np.zeros((1, mesh.vertex_count))
    strength[0, pushed] = 1.0
    solver.step(0.01, Attachment(targets, strength))
    for _ in range(6):
        solver.step(0.05)
    heights = solver.positions[0, inner, 2]
    assert (heights < 0.003).mean() < 0.03
    assert np.abs(solver.positions[0, :, :2] - targets[0, :, :2]).max() < 0.01


def test_a_crossed_layer_is_pushed_back_no_faster_than_it_may_be():
    mesh, limp = two_layers(), ClothParameters(1e6, 1e6, 0.0, 0.0)
    config = SolverConfig(gravity=(0.0, 0.0, 0.0), edge_contact=False)
    solver = ClothSolver(mesh, config, parameters=limp)
    solver.step(0.01)
    middle = mesh.vertex_count // 2
    middle += int(np.argmin(np.linalg.norm(mesh.vertices[middle:, :2], axis=1)))
    crossed = solver.positions[0]
    crossed[middle, 2] -= 0.005
    solver.place(crossed)
    solver.step(config.substep_s)
    back = solver.positions[0, middle, 2] - crossed[middle, 2]
    assert 1e-5 < back <= config.push_out_speed * config.substep_s


@pytest.mark.parametrize("substep_s", [4e-3, 1e-3, 2.5e-4])
def test_a_cloth_attached_softly_to_itself_loses_energy_and_does_not_sag(substep_s):
    mesh = sheet(0.08)
    stand = mesh.with_vertices(mesh.vertices[:, [0, 2, 1]])
    config = SolverConfig(substep_s=substep_s)
    solver = ClothSolver(stand, config)
    solver.set_velocities(np.random.default_rng(3).normal(0.0, 0.2, (1, mesh.vertex_count, 3)))
    soft = Attachment(stand.vertices[None].copy(), np.full((1, mesh.vertex_count), 0.9))

    def energy():
        return 0.5 * masses(mesh, config) @ (solver.velocities[0] ** 2).sum(axis=1)

    energies = [energy()]
    for _ in range(8):
        solver.step(0.05, soft)
        energies.append(energy())
    assert max(energies[1:]) < 0.3 * energies[0]
    assert energies[-1] < 1e-4 * energies[0]
    np.testing.assert_allclose(solver.positions[0], stand.vertices, atol=1e-4)


@pytest.mark.parametrize(("substep_s", "tolerance"), [(5e-3, 0.08), (5e-4, 0.008)])
def test_a_soft_pull_closes_its_share_whatever_the_substeps(substep_s, tolerance):
    mesh = sheet(0.04)
    target = mesh.vertices + np.array([0.01, 0.0, 0.0])
    config = SolverConfig(substep_s=substep_s, gravity=(0.0, 0.0, 0.0), damping=0.0)
    solver = ClothSolver(mesh, config)
    solver.step(0.05, Attachment(target[None], np.full((1, mesh.vertex_count), 0.8)))
    moved = solver.positions[0, :, 0] - mesh.vertices[:, 0]
    np.testing.assert_allclose(moved, 0.008, rtol=tolerance)


def test_targets_inside_the_table_are_lifted():
    mesh = sheet(0.05, 0.0015)
    solver = ClothSolver(mesh, SolverConfig(table=FLOOR))
    below = mesh.vertices - 0.004 * UP
    highest = solver.step(0.01, Attachment(below[None], np.full((1, mesh.vertex_count), 1.0)))
    np.testing.assert_allclose(solver.positions[0, :, 2], 0.0015, atol=1e-6)
    assert highest.max() == 0.0


def test_a_restored_state_replays_bit_for_bit():
    mesh = two_layers()
    solver = ClothSolver(mesh, SolverConfig(table=FLOOR))
    held = HeldMotion(np.array([mesh.vertex_count // 2]), _lift(mesh))
    dynamics = ClothDynamics(solver)
    middle = dynamics.roll_out(solver.save(), held, 0.1).state
    first = dynamics.roll_out(None, None, 0.1)  # goes on without a restore
    solver.step(0.05)
    again = dynamics.roll_out(middle, None, 0.1)
    other = ClothDynamics(ClothSolver(mesh, solver.config)).roll_out(middle, None, 0.1)
    for replay in (again, other):
        np.testing.assert_array_equal(replay.positions, first.positions)
        np.testing.assert_array_equal(replay.state.velocities, first.state.velocities)
        np.testing.assert_array_equal(replay.state.contacts.sides, first.state.contacts.sides)


def test_an_environment_of_a_batch_equals_a_single_run():
    mesh = two_layers()
    config = SolverConfig(table=FLOOR)
    materials = [ClothParameters(1e-4 * k, 3.0, 0.2 * k, 0.1 * k) for k in range(4)]
    batch = ClothSolver(mesh, config, parameters=materials, environments=4)
    lifts = np.stack([_lift(mesh, 0.02 + 0.005 * k) for k in range(4)])
    held = np.array([mesh.vertex_count // 2])
    together = ClothDynamics(batch).roll_out(batch.save(), HeldMotion(held, lifts), 0.1)
    assert np.ptp(together.positions, axis=0).max() > 1e-3
    for index in (0, 3):
        single = ClothSolver(mesh, config, parameters=materials[index])
        motion = HeldMotion(held, lifts[index])
        # The batch is cut as finely as its longest way needs.
        alone = ClothDynamics(single)
        state, steps = single.save(), 7
        if index == 3:
            result = alone.roll_out(state, motion, 0.1)
            np.testing.assert_array_equal(result.positions[0], together.positions[index])
        else:
            for step in range(1, steps + 1):
                targets = np.zeros((1, mesh.vertex_count, 3))
                strength = np.zeros((1, mesh.vertex_count))
                targets[:, held] = motion.at(step / steps)
                strength[:, held] = 1.0
                single.step(0.1 / steps, Attachment(targets, strength))
            np.testing.assert_array_equal(single.positions[0], together.positions[index])


def test_violent_displacement_shows_in_the_highest_speed():
    mesh = sheet(0.08, 0.05)
    rng = np.random.default_rng(5)
    speeds = []
    for amplitude in (0.0, 0.001, 0.008):
        solver = ClothSolver(mesh, SolverConfig(gravity=(0.0, 0.0, 0.0)))
        solver.place(mesh.vertices + rng.normal(0.0, 1.0, mesh.vertices.shape) * amplitude)
        speeds.append(float(solver.step(0.02).max()))
        assert np.isfinite(solver.positions).all()
    assert speeds[0] < 1e-3
    assert speeds[1] > 0.5
    assert speeds[2] > speeds[1]


def test_what_is_too_fast_goes_on_at_the_limit():
    config = SolverConfig(speed_limit=2.0, gravity=(0.0, 0.0, 0.0), damping=0.0)
    solver = ClothSolver(sheet(0.05, 1.0), config)
    solver.set_velocities(np.full(solver.velocities.shape, 5.0))
    assert solver.step(0.005).max() > 8.0
    np.testing.assert_allclose(np.linalg.norm(solver.velocities, axis=-1), 2.0, rtol=1e-3)


def test_numbers_that_are_none_show_as_infinite_speed():
    mesh = sheet(0.05)
    solver = ClothSolver(mesh)
    broken = mesh.vertices.copy()
    broken[3] = np.nan
    solver.place(broken)
    assert np.isinf(solver.step(0.005).max())


def test_a_resting_cloth_sleeps_and_a_cloth_in_the_air_does_not():
    solver = ClothSolver(sheet(0.05, 0.0015), SolverConfig(table=FLOOR))
    solver.step(0.2)
    before = solver.positions
    solver.step(0.5)
    np.testing.assert_array_equal(solver.positions, before)
    aloft = ClothSolver(sheet(0.05, 0.5), SolverConfig(table=FLOOR))
    aloft.step(0.05)
    assert (aloft.positions[0, :, 2] < 0.49).all()


def test_a_resting_cloth_that_is_pulled_by_a_fraction_of_a_millimeter_moves():
    mesh = sheet(0.05, 0.0015)
    solver = ClothSolver(mesh, SolverConfig(table=FLOOR))
    solver.step(0.2)
    goal = solver.positions + np.float32([0.0003, 0.0, 0.0])
    solver.step(0.05, Attachment(goal, np.full((1, mesh.vertex_count), 0.999)))
    assert np.abs(solver.positions - goal).max() < 0.00003


def _lift(mesh, height=0.03):
    start = mesh.vertices[mesh.vertex_count // 2]
    return np.stack([start, start + height * UP])[:, None, :]
