"""Mesh dynamics learn from roll-outs, resume, and are asked like the simulator."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import towel
from clothtrack.planning.action_space import PickPlace
from clothtrack.planning.planning_dynamics import MotionConfig, PlannedCloth, PlanningDynamics
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack_lab.graph_dynamics.mesh_dynamics import (
    MeshDynamics,
    MeshDynamicsConfig,
    load_mesh_dynamics,
)
from clothtrack_lab.graph_dynamics.mesh_network import MeshNetwork, MeshNetworkConfig
from clothtrack_lab.graph_dynamics.mesh_training import (
    DynamicsTrainingConfig,
    MeshDynamicsStage,
    WindowBatch,
    WindowExamples,
    train_mesh_dynamics,
)

TINY = DynamicsTrainingConfig(
    network=MeshNetworkConfig(width=16, message_steps=2, collision_radius_m=0.06, projections=2),
    loop=TrainingConfig(
        epochs=6, batch_size=1, low_rate=3e-3, high_rate=3e-3, save_steps=5, held_out_share=0.3
    ),
    windows=4,
    unrolled=2,
    examples_per_shard=6,
)
FLAT = towel(0.2, 0.2, 0.05)
LYING = PlannedCloth(FLAT, FLAT.vertices + [0.0, 0.0, 0.0015])
ACTION = PickPlace(np.array([0.1, 0.1, 0.0]), np.array([0.0, 0.0, 0.01]), 0.05)


@pytest.fixture(scope="module")
def trained(roll_outs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dynamics")
    return folder, train_mesh_dynamics(roll_outs, "towel", TINY, folder)


@pytest.mark.slow
def test_training_gets_better_and_its_weights_are_read_again(trained):
    _, outcome = trained
    assert outcome.best_step > 0
    learned = load_mesh_dynamics(outcome.weights)
    assert isinstance(learned, PlanningDynamics)
    moved = learned.predict(LYING, [ACTION, None])
    assert np.isfinite(moved).all()
    fresh = MeshNetwork(TINY.network)
    with torch.no_grad():
        other = MeshDynamics(fresh).predict(LYING, [ACTION, None])
    assert not np.allclose(moved, other)


@pytest.mark.slow
def test_an_interrupted_training_arrives_at_the_same_weights(trained, roll_outs, tmp_path):
    _, outcome = trained
    half = replace(TINY, loop=replace(TINY.loop, epochs=3))
    train_mesh_dynamics(roll_outs, "towel", half, tmp_path)
    again = train_mesh_dynamics(roll_outs, "towel", TINY, tmp_path)
    assert again.best_score == outcome.best_score
    one, other = (load_mesh_dynamics(path) for path in (outcome.weights, again.weights))
    np.testing.assert_array_equal(one.predict(LYING, [ACTION]), other.predict(LYING, [ACTION]))
    with pytest.raises(InvalidConfigError, match="noise_m"):
        train_mesh_dynamics(roll_outs, "towel", replace(TINY, noise_m=0.5), tmp_path)


def test_the_loss_of_the_truth_is_zero(roll_outs):
    """A network that predicts what happens: here, of a cloth at rest, nothing."""
    # Fresh, it accelerates nothing; roll-outs may be stretched a little, so nothing is shortened.
    free = replace(
        TINY, network=replace(TINY.network, projections=0, kept_velocity=1.0, gravity=0.0)
    )
    stage = MeshDynamicsStage(free, "towel")
    windows = WindowExamples(roll_outs, TINY, noisy=False)[0, 0]
    still = windows.past[:, -1:].clone()
    still[..., 2].clamp_(min=0.0015)
    resting = type(windows)(
        still.repeat(1, TINY.network.history + 1, 1, 1), still.repeat(1, 2, 1, 1),
        torch.zeros_like(windows.held), windows.springs,
    )  # fmt: skip
    assert float(stage(WindowBatch([resting]))["loss"].detach()) == pytest.approx(0.0, abs=1e-5)


def test_the_held_vertex_ends_at_the_place():
    torch.manual_seed(0)
    dynamics = MeshDynamics(
        MeshNetwork(TINY.network),
        MeshDynamicsConfig(motion=MotionConfig(time_step_s=0.2, rest_s=0.0), together=2),
    )
    moved = dynamics.predict(LYING, [ACTION, None, ACTION])
    corner = int(np.argmax(FLAT.vertices[:, 0] + FLAT.vertices[:, 1]))
    np.testing.assert_allclose(moved[0, corner, :2], ACTION.place[:2], atol=1e-6)
    np.testing.assert_allclose(moved[0], moved[2], atol=1e-6)
    # What nobody takes stays, above the table.
    np.testing.assert_allclose(moved[1], LYING.positions, atol=1e-9)
    assert dynamics.predict(LYING, []).shape == (0, FLAT.vertex_count, 3)
    with pytest.raises(InvalidConfigError, match="time_step_s"):
        MeshDynamics(MeshNetwork(TINY.network), MeshDynamicsConfig(motion=MotionConfig()))
