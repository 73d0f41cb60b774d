import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel
from clothtrack.simulation.dynamics import ClothDynamics
from clothtrack.simulation.parameters import SolverConfig
from clothtrack.simulation.picker_action import HeldMotion, PickerAction
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import Attachment

MESH = towel(0.06, 0.06, 0.01)
CORNER = np.array([0])
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def dynamics():
    return ClothDynamics(ClothSolver(MESH, SolverConfig()))


def attachment(targets, strength):
    return Attachment(targets[None], np.full((1, MESH.vertex_count), strength))


def test_a_hard_pseudo_action_places_every_vertex(dynamics):
    targets = MESH.vertices + 0.02 * UP
    result = dynamics.roll_out(dynamics.solver.save(), None, 0.12, attachment(targets, 1.0))
    np.testing.assert_allclose(result.positions[0], targets, atol=1e-6)
    np.testing.assert_allclose(
        result.state.velocities[0], np.broadcast_to(UP * 0.02 / 0.12, targets.shape), atol=1e-4
    )


def test_a_soft_pseudo_action_leaves_the_velocity_of_the_whole_roll_out(dynamics):
    state = dynamics.solver.save()
    targets = MESH.vertices + 0.01 * UP
    result = dynamics.roll_out(state, None, 0.1, attachment(targets, 0.8))
    moved = result.positions[0] - state.positions[0]
    assert 0.006 < moved[:, 2].mean() < 0.009
    np.testing.assert_allclose(result.state.velocities[0], moved / 0.1, atol=1e-5)


@pytest.mark.parametrize("duration_s", [0.05, 0.2])
def test_a_soft_pull_closes_its_share_in_any_number_of_steps(duration_s):
    settings = SolverConfig(gravity=(0.0, 0.0, 0.0), damping=0.0)
    dynamics = ClothDynamics(ClothSolver(MESH, settings))
    pull = attachment(MESH.vertices + 0.01 * UP, 0.8)
    result = dynamics.roll_out(dynamics.solver.save(), None, duration_s, pull)
    moved = result.positions[0] - MESH.vertices
    np.testing.assert_allclose(moved[:, 2], 0.008, rtol=0.02)


def test_a_coarse_prediction_is_the_roll_out_with_longer_substeps():
    coarse = SolverConfig(substep_s=3.0e-3, rebuild_s=0.03)
    fine = SolverConfig(substep_s=1.0e-3, rebuild_s=0.01)
    way = MESH.vertices[0] + np.linspace(0.0, 0.02, 3)[:, None, None] * UP
    action = PickerAction(HeldMotion(CORNER, way), 0.05)
    wanted = ClothDynamics(ClothSolver(MESH, coarse))
    exact = wanted(wanted.solver.save(), action)
    dynamics = ClothDynamics(ClothSolver(MESH, fine), prediction_coarseness=3)
    start = dynamics.solver.save()
    np.testing.assert_array_equal(dynamics.predict(start, action).positions, exact.positions)
    rolled = dynamics(start, action).positions
    assert 1e-6 < np.abs(rolled - exact.positions).max() < 2e-3
