"""What the network believes of the cloth."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.closest_point import distance_to_mesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.planning.episode_store import write_step
from clothtrack.planning.perception import NetworkPerception, PerceptionConfig
from clothtrack.planning.robots.robot import RgbdFrame
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import ClothDescription, Table
from clothtrack.recordings.store import read_recording
from clothtrack.recordings.template_file import write_template

TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
POSE = np.diag([1.0, -1.0, -1.0, 1.0])
POSE[2, 3] = 0.9
CAMERA = Camera("top", 320, 240, 300.0, 300.0, 159.5, 119.5, POSE)
SIZE_M = (0.45, 0.4)
CONFIG = PerceptionConfig(refined=False, vertex_count=300)


@pytest.fixture
def shown(tmp_path):
    """A towel, askew and flat."""
    flat = towel(*SIZE_M, 0.02)
    turn = np.array([[0.9, -0.436, 0.0], [0.436, 0.9, 0.0], [0.0, 0.0, 1.0]])
    lying = flat.vertices @ turn.T + [0.05, 0.02, 0.01]
    drawn = Rasterizer(flat.faces, CAMERA).render(lying).depth
    frame = RgbdFrame(0.0, CAMERA, np.where(np.isfinite(drawn), drawn, 0.9).astype(np.float32))
    folder = tmp_path / "step"
    write_step(folder, [frame], cloth=ClothDescription(kind="towel", size_m=SIZE_M), table=TABLE)
    return read_recording(folder)


def test_a_refined_belief_has_its_layers_in_either_order(shown):
    pytest.importorskip("torch")
    assert NetworkPerception("towel", CONFIG).perceive(shown).opposite is None
    refined = NetworkPerception("towel", replace(CONFIG, refined=True)).perceive(shown)
    cloud = observe(shown, shown.frames[-1]).points
    for positions in (refined.positions, refined.opposite):
        assert np.median(distance_to_mesh(cloud, positions, refined.flat.faces)) < 0.01


def test_the_belief_is_of_the_template_that_was_given(shown, tmp_path):
    pytest.importorskip("torch")
    cut = towel(*SIZE_M, 0.03)
    write_template(cut, tmp_path / "cut.npz")
    own = replace(CONFIG, template=str(tmp_path / "cut.npz"))
    belief = NetworkPerception("towel", own).perceive(shown)
    np.testing.assert_array_equal(belief.flat.faces, cut.faces)
    cloud = observe(shown, shown.frames[-1]).points
    assert np.median(distance_to_mesh(cloud, belief.positions, cut.faces)) < 0.01
