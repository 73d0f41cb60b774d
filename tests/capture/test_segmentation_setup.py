"""One click or box gives the masks of all frames, in light that the first frame did not show."""

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.colors import CORE, with_shades
from clothtrack.recordings.pictures import read_mask
from clothtrack.recordings.recording import PickerPath
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack_capture.segmentation_setup import SegmentationSetup

CAMERA = Camera("top", 160, 120, 150.0, 150.0, 79.5, 59.5)
CLOTH = np.array([40, 90, 190])


def cloth_mask(frame):
    mask = np.zeros((120, 160), dtype=bool)
    mask[20 + 5 * frame : 90, 30 : 120 - 5 * frame] = True
    return mask


@pytest.fixture
def recording(tmp_path):
    """A blue cloth on wood that turns darker from frame to frame in one half."""
    rng = np.random.default_rng(0)
    with RecordingWriter(tmp_path / "film", [CAMERA], {"top": 0.001}) as writer:
        for frame in range(5):
            color = np.array([200, 166, 124]) + rng.normal(0, 4, (120, 160, 3))
            light = np.ones((120, 160, 1))
            light[:, 60:] -= 0.13 * frame
            mask = cloth_mask(frame)
            color[mask] = (CLOTH * light + rng.normal(0, 4, color.shape))[mask]
            depth = 0.6 + rng.normal(0, 0.0005, mask.shape) - 0.005 * mask
            writer.add_frame(
                0.1 * frame,
                color={"top": np.clip(color, 0, 255).astype(np.uint8)},
                depth={"top": depth},
            )
        path = PickerPath(np.array([0.0, 0.4]), np.zeros((2, 3)), np.array([True, False]))
        writer.set_picker_path("arm", path)
        writer.add_action(0, 4, ["arm"])
    return read_recording(tmp_path / "film")


@pytest.mark.parametrize("how", ["click", "box"])
def test_every_frame_has_its_mask_and_what_is_kept_is_what_was_shown(recording, how):
    setup = SegmentationSetup(recording, recording.cameras[0])
    assert setup.mask(0) is None
    with pytest.raises(InvalidConfigError, match="nothing is chosen yet"):
        setup.keep()
    if how == "click":
        setup.choose_click(0, (70, 50))
    else:
        setup.choose_box(0, (25, 15, 125, 95))
    for frame in range(5):
        found, true = setup.mask(frame), cloth_mask(frame)
        assert (found & true).sum() / (found | true).sum() > 0.95
    setup.keep()
    again = read_recording(recording.folder)
    for frame in again.frames:
        np.testing.assert_array_equal(read_mask(frame.mask["top"]), setup.mask(frame.index))
    assert again.cloth.color == "blue"
    assert again.provenance["masks_from"]["frame"] == 0
    assert again.actions == recording.actions
    # And once more, after a second thought.
    second = SegmentationSetup(again, again.cameras[0])
    np.testing.assert_array_equal(second.mask(2), setup.mask(2))
    second.choose_click(4, (45, 60))
    second.keep()
    assert read_recording(recording.folder).provenance["masks_from"]["frame"] == 4


def test_what_is_not_there_cannot_be_chosen(recording):
    setup = SegmentationSetup(recording, recording.cameras[0])
    with pytest.raises(InvalidConfigError, match="frame 9; choose one from 0 to 4"):
        setup.choose_click(9, (1, 1))
    with pytest.raises(InvalidConfigError, match="outside the picture"):
        setup.choose_click(0, (500, 1))
    with pytest.raises(InvalidConfigError, match="not inside the picture"):
        setup.choose_box(0, (10, 10, 500, 50))
    assert not setup.chosen


def test_depth_alone_is_no_place_to_click(tmp_path):
    with RecordingWriter(tmp_path / "dark", [CAMERA], {"top": 0.001}) as writer:
        writer.add_frame(0.0, depth={"top": np.full((120, 160), 0.6)})
    recording = read_recording(tmp_path / "dark")
    with pytest.raises(InvalidRecordingError, match="no frame with both"):
        SegmentationSetup(recording, recording.cameras[0])


def test_shades_keep_hue_and_leave_the_background_alone():
    color = np.zeros((40, 40, 3), np.uint8)
    color[:, :20], color[:, 20:] = (40, 90, 190), (90, 45, 20)
    cloth = np.zeros((40, 40), dtype=bool)
    cloth[:, :20] = True
    members = np.zeros((32, 32, 32), np.uint8)
    members[40 >> 3, 90 >> 3, 190 >> 3] = CORE
    shaded = with_shades(members, color, cloth)

    def holds(rgb):
        return shaded[tuple(channel >> 3 for channel in rgb)] == CORE

    assert holds((40, 90, 190))
    assert holds((20, 45, 95))
    assert holds((52, 117, 247))
    assert not holds((90, 45, 20))
    assert not holds((190, 90, 40))
    assert not holds((128, 128, 128))
