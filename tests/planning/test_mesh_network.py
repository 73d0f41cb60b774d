"""The graph network keeps the symmetries of what it models."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from clothtrack.garments.garment_meshes import towel
from clothtrack_lab.graph_dynamics.mesh_dynamics import springs_of
from clothtrack_lab.graph_dynamics.mesh_network import (
    MeshNetwork,
    MeshNetworkConfig,
    Ways,
    roll_out,
)
from clothtrack_lab.graph_dynamics.mesh_prior import (
    contacts,
)

CONFIG = MeshNetworkConfig(width=16, message_steps=2)
FLAT = towel(0.2, 0.2, 0.04)


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    network = MeshNetwork(CONFIG).eval()
    # A fresh one accelerates nothing, which would keep every symmetry.
    torch.nn.init.normal_(network.decode[-1].weight)
    return network


def state(copies=1):
    torch.manual_seed(1)
    positions = torch.tensor(FLAT.vertices, dtype=torch.float32)[None].repeat(copies, 1, 1)
    positions = positions + 0.01 * torch.randn(copies, *positions.shape[1:])
    velocities = 0.1 * torch.randn(*positions.shape[:2], CONFIG.history, 3)
    held = torch.zeros(positions.shape[:2], dtype=torch.bool)
    held[:, 3] = True
    return positions, velocities, held


def accelerations(network, positions, velocities, held, springs=None):
    springs = springs or springs_of(FLAT)
    near = contacts(positions, CONFIG.collision_radius_m)
    with torch.no_grad():
        return network(positions, velocities, positions[..., 2], held, near, springs=springs)


def test_a_shift_over_the_table_changes_nothing(network):
    positions, velocities, held = state()
    here = accelerations(network, positions, velocities, held)
    there = accelerations(network, positions + torch.tensor([0.5, -0.25, 0.0]), velocities, held)
    np.testing.assert_allclose(here, there, atol=1e-4)


def test_cloths_of_a_batch_do_not_hear_each_other(network):
    positions, velocities, held = state(3)
    together = accelerations(network, positions, velocities, held)
    alone = accelerations(network, positions[1:2], velocities[1:2], held[1:2])
    np.testing.assert_allclose(together[1:2], alone, atol=1e-5)


def test_numbering_means_nothing(network):
    positions, velocities, held = state()
    order = torch.randperm(FLAT.vertex_count, generator=torch.Generator().manual_seed(2))
    new_number = torch.argsort(order)
    springs = springs_of(FLAT)
    renamed = type(springs)(
        new_number[springs.sender], new_number[springs.receiver], springs.rest,
        springs.joined[order][:, order], springs.count[order],
        springs.along[order][:, order],
    )  # fmt: skip
    here = accelerations(network, positions, velocities, held)
    there = accelerations(
        network, positions[:, order], velocities[:, order], held[:, order], renamed
    )
    np.testing.assert_allclose(here[:, order], there, atol=1e-5)


def test_a_held_corner_draws_the_cloth_along_and_stretches_it_little():
    """A fresh network accelerates nothing: what moves is drawn by edges."""
    positions = torch.tensor(FLAT.vertices, dtype=torch.float32)[None]
    springs = springs_of(FLAT)
    corner = int(torch.argmax(positions[0, :, 0] + positions[0, :, 1]))
    # Out to the side by half the cloth, 1 cm per step.
    places = positions[:, corner : corner + 1] + 0.01 * torch.arange(1, 11)[:, None] * (
        torch.tensor([1.0, 0.0, 0.0])
    )
    ways = Ways(torch.tensor([corner]), places, torch.tensor([10]))
    strain = {}
    for projections in (0, 10):
        free = replace(CONFIG, projections=projections, dragging=0, tethered=False)
        network = MeshNetwork(free).eval()
        after = roll_out(network, positions, springs, ways, steps=10)
        np.testing.assert_allclose(after[0, corner], places[0, -1], atol=1e-6)
        gap = (after[:, springs.sender] - after[:, springs.receiver]).norm(dim=-1)
        strain[projections] = float((gap / springs.rest - 1.0).clamp_min(0.0).max())
    assert strain[0] > 1.0
    assert strain[10] < 0.1 * strain[0]
