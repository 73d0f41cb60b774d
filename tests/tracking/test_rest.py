"""A cloth lies still if its depth has not changed beyond the noise, whatever moves beside it."""

import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import PickerPath
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack.simulation.picker_action import HeldMotion, PickerAction
from clothtrack.tracking.rest import PicturesAtRest

CAMERA = Camera("top", 160, 120, 150.0, 150.0, 79.5, 59.5, np.diag([1.0, -1.0, -1.0, 1.0]))
FREE = PickerAction(None, 0.1)
HOLDING = PickerAction(HeldMotion(np.array([0]), np.zeros((2, 1, 3))), 0.1)


def depth(noise_m, *, flap_m=0.0, beside_m=0.0, seed=0):
    """A cloth of 80 x 60 pixels on a table: a flap may rise, something may move beside it."""
    picture = np.full((120, 160), 0.8)
    picture[30:90, 40:120] -= 0.01
    picture[70:90, 90:120] -= flap_m
    picture[5:20, 5:20] -= beside_m
    return picture + np.random.default_rng(seed).normal(0.0, noise_m, picture.shape)


@pytest.fixture
def still(tmp_path):
    """Whether the cloth lies in one picture as in the other."""

    def compare(before, after, action=FREE):
        times, mask = 0.1 * np.arange(2), np.zeros((120, 160), bool)
        mask[30:90, 40:120] = True
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        with RecordingWriter(folder, (CAMERA,), {"top": 1e-4}) as writer:
            for time_s, picture in zip(times, (before, after), strict=True):
                writer.add_frame(time_s, depth={"top": picture}, mask={"top": mask})
            writer.set_picker_path("hand", PickerPath(times, np.zeros((2, 3)), times < 0))
            writer.add_action(0, 1, ("hand",))
        recording = read_recording(folder)
        at_rest = PicturesAtRest(recording, lambda frame: observe(recording, frame))
        return at_rest(action, *recording.frames)

    return compare


@pytest.mark.parametrize("noise_m", [0.0, 0.0013, 0.003])
def test_noise_is_no_motion_and_a_flap_that_sinks_is(still, noise_m):
    before = depth(noise_m, seed=1)
    assert still(before, depth(noise_m, seed=2))
    assert not still(before, depth(noise_m, flap_m=0.012, seed=2))


def test_what_moves_beside_the_cloth_does_not_count(still):
    assert still(depth(0.001), depth(0.001, beside_m=0.2, seed=2))


def test_a_held_cloth_is_never_at_rest(still):
    assert not still(depth(0.0), depth(0.0), HOLDING)
