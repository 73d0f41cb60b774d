"""The network's perception: one belief per view, each of the same cloth."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.closest_point import distance_to_mesh
from clothtrack.geometry.visibility import Rasteriser
from clothtrack.planning.episode_store import write_step
from clothtrack.planning.perception import Look, NetworkPerception, PerceptionConfig
from clothtrack.planning.robot import RgbdFrame
from clothtrack.recordings.recording import ClothDescription, Table
from clothtrack.recordings.store import read_recording
from clothtrack.simulation.garments import towel

TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
POSE = np.diag([1.0, -1.0, -1.0, 1.0])
POSE[2, 3] = 0.9
CAMERA = Camera("top", 320, 240, 300.0, 300.0, 159.5, 119.5, POSE)
SIZE_M = (0.45, 0.4)
CONFIG = PerceptionConfig(refined=False, vertex_count=300)


@pytest.fixture
def look(tmp_path):
    """A towel, askew and flat."""
    flat = towel(*SIZE_M, 0.02)
    turn = np.array([[0.9, -0.436, 0.0], [0.436, 0.9, 0.0], [0.0, 0.0, 1.0]])
    lying = flat.vertices @ turn.T + [0.05, 0.02, 0.01]
    drawn = Rasteriser(flat.faces, CAMERA).render(lying).depth
    frame = RgbdFrame(0.0, CAMERA, np.where(np.isfinite(drawn), drawn, 0.9).astype(np.float32))
    folder = tmp_path / "step"
    write_step(folder, [frame], cloth=ClothDescription(kind="towel", size_m=SIZE_M), table=TABLE)
    return Look(read_recording(folder), acted=False)


@pytest.mark.parametrize("views", [1, 2, 4])
def test_every_view_is_a_belief_of_the_same_cloth(look, views):
    pytest.importorskip("torch")
    perception = NetworkPerception("towel", replace(CONFIG, views=views))
    beliefs = perception.perceive(look)
    assert len(beliefs) == views
    cloud = look.observation().points
    for one in beliefs:
        assert one.source == "network"
        assert np.median(distance_to_mesh(cloud, one.positions, one.flat.faces)) < 0.01
    if views > 1:
        # The network sees another picture, or all of this would be for nothing.
        assert np.abs(beliefs[0].positions - beliefs[1].positions).max() > 1e-3


@pytest.mark.parametrize("views", [0, 17])
def test_no_view_and_too_many_are_refused(views):
    with pytest.raises(InvalidConfigError, match=f"views is {views}; it must be from 1 to 16"):
        PerceptionConfig(views=views)
