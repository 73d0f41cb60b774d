"""The simulated world's physics: rest, free fall, and a grip that follows the tip."""

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import towel
from clothtrack_lab.world.flex import CONTACT_RADIUS_M, TIME_STEP_S, Fabric, FlexWorld


def lifted_towel(height: float) -> FlexWorld:
    mesh = towel(0.12, 0.12, 0.02)
    return FlexWorld(mesh.with_vertices(mesh.vertices + np.array([0.0, 0.0, height])), Fabric())


def test_cloth_falls_freely() -> None:
    world = lifted_towel(0.3)
    world.step(20)
    time = 20 * TIME_STEP_S
    assert world.time_s == pytest.approx(time)
    # A first-order integrator is off by at most one step of the final speed.
    fallen = 0.3 - world.positions[:, 2]
    assert np.abs(fallen - 0.5 * 9.81 * time**2).max() < 9.81 * time * TIME_STEP_S


def test_cloth_rests_on_the_table_and_stays() -> None:
    world = lifted_towel(CONTACT_RADIUS_M)
    start = world.positions
    world.settle(speed=0.002, limit_s=0.5)
    world.step(20)
    assert world.speed_rms < 0.002
    assert np.abs(world.positions[:, :2] - start[:, :2]).max() < 1e-4
    assert (world.positions[:, 2] > 0.0).all()


def test_held_vertex_follows_the_tip_and_is_let_go() -> None:
    world = lifted_towel(CONTACT_RADIUS_M)
    world.settle()
    tip = world.positions[0]
    world.grasp(np.array([0]), tip)
    for _ in range(60):
        tip = tip + np.array([0.0, 0.0, 0.2 * TIME_STEP_S])
        world.move(tip)
        world.step()
    assert np.linalg.norm(world.positions[0] - tip) < 0.004
    assert world.positions[-1, 2] < 0.03
    world.release()
    world.step(100)
    assert world.positions[0, 2] < 0.03


def test_a_restored_world_goes_on_as_the_saved_one_did():
    mesh = towel(0.1, 0.1, 0.02)
    world = FlexWorld(mesh.with_vertices(mesh.vertices + [0.0, 0.0, 0.05]), Fabric())
    world.step(10)
    saved, there = world.save(), world.positions
    world.step(20)
    later = world.positions
    world.restore(saved)
    np.testing.assert_array_equal(world.positions, there)
    world.step(20)
    np.testing.assert_allclose(world.positions, later, atol=1e-9)
    with pytest.raises(InvalidConfigError, match="another cloth"):
        world.restore(saved[:-1])
