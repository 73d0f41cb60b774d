"""The robot of the simulated world: its starts are cloth that could be."""

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.geometry.quality import crossings
from clothtrack_lab.world.episodes import SMALL_WORLD
from clothtrack_lab.world.simulated_robot import SimulatedRobot, SimulatedRobotConfig


@pytest.mark.slow
@pytest.mark.parametrize("seed", [9020, 9023])
def test_a_dropped_shirt_does_not_pass_through_itself(seed):
    # With the usual contacts 99 and 127 edges of these two do.
    robot = SimulatedRobot("tshirt", seed)
    robot.crumple()
    flat, positions = robot.true_cloth()
    assert crossings(positions, flat.faces) <= 10


def test_a_saved_world_is_restored_with_its_own_contacts_only(tmp_path):
    config = SimulatedRobotConfig(episode=SMALL_WORLD, film=False)
    robot = SimulatedRobot("towel", 3, config)
    robot.save(tmp_path / "world.npz")
    again = SimulatedRobot("towel", 3, config)
    again.restore(tmp_path / "world.npz")
    np.testing.assert_array_equal(again.true_cloth()[1], robot.true_cloth()[1])
    softer = SimulatedRobotConfig(episode=SMALL_WORLD, film=False, contact_s=0.02)
    with pytest.raises(InvalidConfigError, match=r"contact_s of 0\.01, not 0\.02"):
        SimulatedRobot("towel", 3, softer).restore(tmp_path / "world.npz")
    with np.load(tmp_path / "world.npz") as file:
        younger = {"contact_s", "noise", "sha256"}
        undated = {name: file[name] for name in file if name not in younger}
    np.savez(tmp_path / "old.npz", **undated)
    with pytest.raises(InvalidConfigError, match=r"contact_s of 0\.02, not 0\.01"):
        again.restore(tmp_path / "old.npz")
    undated["noise"] = np.array('{"sensor": {"noise": 3, "patches": 0}, "picker": {}}')
    np.savez(tmp_path / "bad.npz", **undated, contact_s=np.array(0.01))
    with pytest.raises(InvalidResultError, match="not a saved world"):
        again.restore(tmp_path / "bad.npz")
    too_hard = SimulatedRobotConfig(episode=SMALL_WORLD, film=False, contact_s=0.009)
    with pytest.raises(InvalidConfigError, match="two time steps"):
        SimulatedRobot("towel", 3, too_hard)
