"""What the network and the tracker believe of the cloth."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh_distance import distance_to_mesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.planning.episode_store import write_step
from clothtrack.planning.perception import (
    Estimate,
    Look,
    NetworkPerception,
    PerceptionConfig,
    TrackerPerception,
    unseen_path_m,
)
from clothtrack.planning.robots.robot import Execution, RgbdFrame
from clothtrack.recordings.recording import ClothDescription, PickerPath, Table
from clothtrack.recordings.store import read_recording
from clothtrack.recordings.template_file import write_template

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
    drawn = Rasterizer(flat.faces, CAMERA).render(lying).depth
    frame = RgbdFrame(0.0, CAMERA, np.where(np.isfinite(drawn), drawn, 0.9).astype(np.float32))
    folder = tmp_path / "step"
    write_step(folder, [frame], cloth=ClothDescription(kind="towel", size_m=SIZE_M), table=TABLE)
    return Look(read_recording(folder), acted=False)


def test_the_network_believes_in_the_cloth_that_is_seen(look):
    pytest.importorskip("torch")
    belief = NetworkPerception("towel", CONFIG).perceive(look)
    assert belief.source == "network"
    cloud = look.observation().points
    assert np.median(distance_to_mesh(cloud, belief.positions, belief.flat.faces)) < 0.01


def test_a_refined_belief_has_its_layers_in_either_order(look):
    pytest.importorskip("torch")
    assert NetworkPerception("towel", CONFIG).perceive(look).opposite is None
    refined = NetworkPerception("towel", replace(CONFIG, refined=True)).perceive(look)
    cloud = look.observation().points
    for positions in (refined.positions, refined.opposite):
        assert np.median(distance_to_mesh(cloud, positions, refined.flat.faces)) < 0.01


def test_the_belief_is_of_the_template_that_was_given(look, tmp_path):
    pytest.importorskip("torch")
    cut = towel(*SIZE_M, 0.03)
    write_template(cut, tmp_path / "cut.npz")
    own = replace(CONFIG, template=str(tmp_path / "cut.npz"))
    belief = NetworkPerception("towel", own).perceive(look)
    np.testing.assert_array_equal(belief.flat.faces, cut.faces)
    cloud = look.observation().points
    assert np.median(distance_to_mesh(cloud, belief.positions, cut.faces)) < 0.01


class Anew:
    """Says that it was asked."""

    def __init__(self, estimate):
        self.estimate = estimate

    def perceive(self, look):
        del look
        return self.estimate


def acted(folder, picture_times_s):
    """A towel of which nothing is seen moving, and a picker that drags it 20 cm in 2 s."""
    depth = np.full((240, 320), 0.9, np.float32)
    depth[60:160, 80:200] = 0.89
    frames = [RgbdFrame(time_s, CAMERA, depth) for time_s in picture_times_s]
    tips = np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.2, 0.0, 0.1]])
    path = PickerPath(np.array([0.0, 1.0, 3.0, 4.0]), tips, np.array([False, True, False, False]))
    done = Execution(path, tuple(frames), grasped=True)
    write_step(
        folder, frames, cloth=ClothDescription(kind="towel", size_m=SIZE_M), table=TABLE,
        execution=done,
    )  # fmt: skip
    return read_recording(folder)


def test_cloth_that_was_carried_unseen_is_perceived_anew(tmp_path, caplog):
    flat = towel(*SIZE_M, 0.03)
    lying = flat.vertices + [0.0, 0.0, 0.0015]
    fresh = Estimate(flat, lying + 0.01, "network")
    perception = TrackerPerception(Anew(fresh))
    before = Estimate(flat, lying, "network")

    unseen = acted(tmp_path / "unseen", [0.0, 3.5, 4.0])
    assert unseen_path_m(unseen) == pytest.approx(0.2)
    assert perception.perceive(Look(unseen, acted=True, before=before)) is fresh
    assert "carried 0.20 m between two pictures (limit 0.06 m)" in caplog.text

    filmed = acted(tmp_path / "filmed", np.linspace(0.0, 4.0, 9))
    assert unseen_path_m(filmed) == pytest.approx(0.05)
    look = Look(filmed, acted=True, before=before)
    tracked = TrackerPerception(Anew(fresh), lost_m=1.0).perceive(look)
    assert tracked.source == "tracker"

    assert TrackerPerception(Anew(fresh), lost_m=1e-4).perceive(look) is fresh
    assert "mm from its cloud (limit 0 mm): perceived anew" in caplog.text


def test_a_limit_that_nothing_keeps_is_refused():
    with pytest.raises(InvalidConfigError, match="lost_m is 0"):
        PerceptionConfig(lost_m=0.0)
