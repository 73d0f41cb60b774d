"""The clouds of a recording: a picture is decoded and segmented once, whoever looks at it."""

from dataclasses import fields

import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.recordings import camera_view
from clothtrack.recordings.geometry_checks import small_pictures as reduction
from clothtrack.recordings.geometry_checks.finding import ObservedFrames
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import PickerPath
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack.tracking.pipeline import observer

CAMERA = Camera("top", 160, 120, 150.0, 150.0, 79.5, 59.5, np.diag([1.0, -1.0, -1.0, 1.0]))


@pytest.fixture
def recording(tmp_path):
    rng, times = np.random.default_rng(0), 0.1 * np.arange(3)
    with RecordingWriter(tmp_path / "r", (CAMERA,), {"top": 1e-4}) as writer:
        for time_s in times:
            color = rng.integers(0, 255, (120, 160, 3), dtype=np.uint8)
            writer.add_frame(
                time_s, color={"top": color}, depth={"top": np.full((120, 160), 0.8)}
            )  # fmt: skip
        writer.set_picker_path("hand", PickerPath(times, np.zeros((3, 3)), times < 0))
        writer.add_action(0, 2, ("hand",))
    return read_recording(tmp_path / "r")


def decoded_by(module, monkeypatch):
    """Return the list of the pictures that a module decodes from now on."""
    decoded = []
    for name in ("read_color", "read_depth"):
        real = getattr(module, name)

        def read(path, *unit, real=real):
            decoded.append(path)
            return real(path, *unit)

        monkeypatch.setattr(module, name, read)
    return decoded


def middle(color, depth_m, camera, table):
    return np.pad(np.ones((80, 100), bool), ((20, 20), (30, 30)))


def test_every_picture_is_decoded_once_also_where_points_are_followed(recording, monkeypatch):
    pictures = []

    def segmenter(color, depth_m, camera, table):
        pictures.append(color)
        return middle(color, depth_m, camera, table)

    decoded = decoded_by(camera_view, monkeypatch)
    clouds = observer(recording, 0.004, segmenter, color=True)
    seen = [clouds(frame) for frame in recording.frames]
    assert len(pictures) == 3
    assert len(decoded) == len(set(decoded)) == 6
    for frame, observation in zip(recording.frames, seen, strict=True):
        alone = observe(recording, frame, segmenter)
        np.testing.assert_array_equal(observation.points, alone.points)


@pytest.mark.parametrize("color", [True, False])
def test_what_was_looked_at_is_not_decoded_again_for_the_checks(recording, monkeypatch, color):
    reducer = reduction.PictureReducer(recording)
    clouds = observer(recording, 0.004, middle, color=color, look=reducer.look)
    seen = clouds(recording.frames[0]), clouds(recording.frames[2])
    frames = ObservedFrames(recording, clouds, reducer)
    decoded = decoded_by(reduction, monkeypatch)
    found = frames.small
    left_out = recording.frames[1]
    assert decoded == [left_out.depth["top"], left_out.color["top"]]
    whole = reduction.PictureReducer(recording).pictures()
    for field in fields(whole):
        given, expected = getattr(found, field.name), getattr(whole, field.name)
        np.testing.assert_array_equal(given, expected, err_msg=field.name)
    assert (frames.at(0), frames.at(2)) == seen
