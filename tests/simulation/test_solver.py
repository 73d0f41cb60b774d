import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import towel
from clothtrack.simulation.parameters import ClothParameters, SolverConfig
from clothtrack.simulation.solver import ClothSolver

MESH = towel(0.05, 0.05, 0.01)


def test_a_single_state_is_given_to_all_environments():
    single, batch = ClothSolver(MESH), ClothSolver(MESH, environments=3)
    single.step(0.02)
    state = single.save()
    batch.restore(state)
    for index in range(3):
        np.testing.assert_array_equal(batch.positions[index], state.positions[0])
        np.testing.assert_array_equal(batch.velocities[index], state.velocities[0])


def test_wrong_numbers_of_environments_are_refused():
    with pytest.raises(InvalidConfigError, match="2 ClothParameters for 3 environments"):
        ClothSolver(MESH, parameters=[ClothParameters()] * 2, environments=3)
    with pytest.raises(InvalidConfigError, match="a state of 2 environments for 3"):
        ClothSolver(MESH, environments=3).restore(ClothSolver(MESH, environments=2).save())
    other = ClothSolver(towel(0.04, 0.04, 0.01))
    with pytest.raises(InvalidConfigError, match="vertices"):
        ClothSolver(MESH).restore(other.save())


@pytest.mark.parametrize(
    "setting", [{"damping": -1.0}, {"substep_s": 0.0}, {"buckling": 0.5}, {"bend_limit": 1.5},
                {"contact_depth_m": np.nan}, {"gravity": (0.0, np.nan, 0.0)}],
)  # fmt: skip
def test_physics_that_gain_energy_or_leave_the_numbers_are_refused(setting):
    (name,) = setting
    with pytest.raises(InvalidConfigError, match=f"solver.{name} is .*; it must be "):
        SolverConfig(**setting)
