import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import towel
from clothtrack.recordings.recording import Table
from clothtrack.simulation.parameters import ClothParameters, SolverConfig
from clothtrack.simulation.solver import ClothSolver

MESH = towel(0.05, 0.05, 0.01)
FLOOR = Table(point=np.zeros(3), normal=np.array([0.0, 0.0, 1.0]))


def test_a_single_state_is_given_to_all_environments():
    single, batch = ClothSolver(MESH), ClothSolver(MESH, environments=3)
    single.step(0.02)
    state = single.save()
    batch.restore(state)
    for index in range(3):
        np.testing.assert_array_equal(batch.positions[index], state.positions[0])
        np.testing.assert_array_equal(batch.velocities[index], state.velocities[0])


def test_any_duration_uses_the_same_graphs():
    solver = ClothSolver(MESH, SolverConfig(damping=0.0))
    for duration in (0.0031, 0.05, 0.0004):
        solver.step(duration)
    np.testing.assert_allclose(solver.velocities[0, :, 2], -9.81 * 0.0535, rtol=1e-3)


def test_placing_keeps_velocities_and_contact_memory():
    solver = ClothSolver(MESH)
    solver.step(0.01)
    before = solver.save()
    solver.place(MESH.vertices)
    after = solver.save()
    np.testing.assert_array_equal(after.velocities, before.velocities)
    np.testing.assert_array_equal(after.contacts.sides, before.contacts.sides)
    np.testing.assert_allclose(after.positions[0], MESH.vertices, atol=1e-7)


def test_wrong_numbers_of_environments_are_refused():
    with pytest.raises(InvalidConfigError, match="2 ClothParameters for 3 environments"):
        ClothSolver(MESH, parameters=[ClothParameters()] * 2, environments=3)
    with pytest.raises(InvalidConfigError, match="a state of 2 environments for 3"):
        ClothSolver(MESH, environments=3).restore(ClothSolver(MESH, environments=2).save())
    other = ClothSolver(towel(0.04, 0.04, 0.01))
    with pytest.raises(InvalidConfigError, match="vertices"):
        ClothSolver(MESH).restore(other.save())


def test_settings_that_cannot_be_computed_are_refused():
    with pytest.raises(InvalidConfigError, match=r"cloth_parameters\.table_friction"):
        ClothParameters(table_friction=-0.1)
    with pytest.raises(InvalidConfigError, match=r"solver\.substep_s"):
        SolverConfig(substep_s=0.0)
    with pytest.raises(InvalidConfigError, match=r"buckling is 0\.5; it must be at least 1"):
        SolverConfig(buckling=0.5)
    with pytest.raises(InvalidConfigError, match="contact_depth_m"):
        SolverConfig(thickness_m=0.02)


@pytest.mark.parametrize(
    "setting",
    [
        {"damping": -1.0}, {"damping": np.nan}, {"sleep_speed": -0.1}, {"speed_limit": 0.0},
        {"contact_margin_m": -1e-3}, {"contact_depth_m": np.nan}, {"push_out_speed": -1.0},
        {"bend_limit": 1.5}, {"gravity": (0.0, np.nan, 0.0)},
    ],
)  # fmt: skip
def test_physics_that_gain_energy_or_leave_the_numbers_are_refused(setting):
    (name,) = setting
    with pytest.raises(InvalidConfigError, match=f"solver.{name} is .*; it must be "):
        SolverConfig(**setting)
