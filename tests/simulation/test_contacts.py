import numpy as np
import pytest

from clothtrack.garments.garment_meshes import tshirt
from clothtrack.simulation.contact.triangle_contact import GatheredPush
from clothtrack.simulation.parameters import ClothParameters
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import ClothState, ContactMemory

SHIRT = tshirt(0.15, 0.13, 0.012)
MATERIALS = [ClothParameters(particle_friction=friction) for friction in (0.2, 0.5)]


def crumpled_solver() -> ClothSolver:
    """Two environments of a shirt whose layers were pressed into each other."""
    solver = ClothSolver(SHIRT, parameters=MATERIALS, environments=2)
    solver.step(0.005)
    noise = np.random.default_rng(0).normal(scale=0.001, size=SHIRT.vertices.shape)
    solver.place((SHIRT.vertices + noise) * (1.0, 1.0, 0.3))
    solver.step(0.002)
    return solver


def test_scattered_and_gathered_impulses_are_the_same_sums():
    solver = crumpled_solver()
    contact, buffers = solver._contact, solver._buffers
    contact.find()
    contact._push.launch()
    scattered = buffers.moves.numpy().copy(), buffers.stops.numpy().copy()
    assert (np.linalg.norm(scattered[0], axis=2) > 1e-6).sum() > 30
    assert not np.array_equal(scattered[1][0], scattered[1][1])  # friction differs
    gathered = GatheredPush(contact)
    gathered.prepare()
    gathered.launch()
    np.testing.assert_allclose(scattered[0], buffers.moves.numpy(), atol=1e-9)
    np.testing.assert_allclose(scattered[1], buffers.stops.numpy(), atol=1e-9)
    assert contact.overflows.numpy().max() == 0


def test_every_vertex_at_a_triangle_is_listed_with_it():
    solver = crumpled_solver()
    contact = solver._contact
    contact.find()
    for positions, listed, count in zip(
        solver.positions.astype(np.float64), contact.sides.numpy(), contact.counts.numpy(),
        strict=True,
    ):  # fmt: skip
        a, b, c = positions[SHIRT.faces].swapaxes(0, 1)
        normal = np.cross(b - a, c - a)
        square = (normal**2).sum(axis=1)
        height, second, third = (
            np.einsum("vfk,fk->vf", positions[:, None] - a, along / size[:, None])
            for along, size in (
                (normal, np.sqrt(square)),
                (np.cross(c - a, normal), square),
                (np.cross(normal, b - a), square),
            )
        )
        weights = np.min([1.0 - second - third, second, third], axis=0)
        strange = (SHIRT.faces != np.arange(len(positions))[:, None, None]).all(axis=2)
        within = solver.config.thickness_m + solver.config.contact_margin_m - 1e-6
        touching = strange & (weights > -0.149) & (np.abs(height) < within)
        assert touching.sum() > 200
        found = np.zeros(touching.shape, bool)
        filled = np.arange(listed.shape[1]) < count[:, None]
        found[np.nonzero(filled)[0], np.abs(listed[filled]) - 1] = True
        assert not (touching & ~found).any()
        assert (weights[found] > -0.151).all()


def one_of(state, index):
    """One environment of a state alone."""
    memory = {name: values[index : index + 1] for name, values in vars(state.contacts).items()}
    alone = slice(index, index + 1)
    return ClothState(state.positions[alone], state.velocities[alone], ContactMemory(**memory))


@pytest.mark.parametrize("index", [0, 1])
def test_a_batch_in_contact_has_the_bits_of_single_runs(index):
    batch = crumpled_solver()
    state = one_of(batch.save(), index)
    single = ClothSolver(SHIRT, parameters=MATERIALS[index])
    single.restore(state)
    batch.step(0.02)
    single.step(0.02)
    np.testing.assert_array_equal(batch.positions[index], single.positions[0])
    np.testing.assert_array_equal(batch.velocities[index], single.velocities[0])
