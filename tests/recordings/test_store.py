"""What is written is read back exactly, and appears whole or not at all."""

import errno
import os
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError, StorageError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import read_cloud, read_color, read_depth, read_mask
from clothtrack.recordings.recording import PickerPath
from clothtrack.recordings.store import RecordingWriter, read_recording, write_recording


@pytest.mark.parametrize("unit_m", [0.001, 0.0002, 0.00025])
def test_depth_comes_back_bit_for_bit(tmp_path, camera, unit_m):
    units = (np.arange(64 * 48) ** 2 % 39_989).astype(np.uint16).reshape(48, 64)
    depth = units.astype(np.float32) * np.float32(unit_m)
    with RecordingWriter(tmp_path / "r", [camera], {"top": unit_m}) as writer:
        writer.add_frame(0.0, depth={"top": depth})
    recording = read_recording(tmp_path / "r")
    back = read_depth(recording.frames[0].depth["top"], unit_m)
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, depth)


def test_everything_else_comes_back_exactly(tmp_path, write, square):
    first = write(tmp_path / "first")
    second = write_recording(first, tmp_path / "second")
    assert second.name == "second"
    assert second.actions == first.actions
    assert second.depth_units_m == first.depth_units_m
    assert second.observed == first.observed
    assert second.provenance == first.provenance
    assert (second.cloth.kind, second.cloth.color, second.cloth.size_m) == (
        "towel",
        "blue",
        (0.1, 0.1),
    )
    np.testing.assert_array_equal(second.cloth.template.vertices, square.vertices)
    np.testing.assert_array_equal(second.cloth.template.faces, square.faces)
    np.testing.assert_array_equal(second.cloth.template.canonical, square.canonical)
    np.testing.assert_array_equal(second.cloth.held_vertices["arm"], [0])
    for name in ("time_s", "positions", "closed"):
        np.testing.assert_array_equal(
            getattr(second.picker_paths["arm"], name), getattr(first.picker_paths["arm"], name)
        )
    np.testing.assert_array_equal(
        second.cameras[0].world_from_camera, first.cameras[0].world_from_camera
    )
    for a, b in zip(first.frames, second.frames, strict=True):
        assert (a.index, a.time_s) == (b.index, b.time_s)
        np.testing.assert_array_equal(read_color(a.color["top"]), read_color(b.color["top"]))
        np.testing.assert_array_equal(read_mask(a.mask["top"]), read_mask(b.mask["top"]))


def test_color_keeps_red_first(tmp_path, camera):
    red = np.zeros((48, 64, 3), np.uint8)
    red[..., 0] = 200
    with RecordingWriter(tmp_path / "r", [camera], {"top": 0.001}) as writer:
        writer.add_frame(0.0, color={"top": red}, depth={"top": np.full((48, 64), 0.5)})
    np.testing.assert_array_equal(read_color(tmp_path / "r/color/000000.png"), red)


def test_several_cameras_have_folders_of_their_own(tmp_path, camera):
    side = Camera("side", 32, 24, 30.0, 30.0, 15.5, 11.5)
    with RecordingWriter(tmp_path / "r", [camera, side], {"top": 0.001, "side": 0.0001}) as writer:
        writer.add_frame(0.0, depth={"top": np.full((48, 64), 0.5), "side": np.full((24, 32), 0.3)})
    frame = read_recording(tmp_path / "r").frames[0]
    assert (tmp_path / "r/depth/side/000000.png").is_file()
    assert read_depth(frame.depth["side"], 0.0001)[0, 0] == pytest.approx(0.3)
    assert read_depth(frame.depth["top"], 0.001)[0, 0] == pytest.approx(0.5)


def test_a_recording_may_hold_clouds_only(tmp_path, camera):
    cloud = np.random.default_rng(0).normal(size=(50, 3))
    with RecordingWriter(tmp_path / "r", [camera], {}) as writer:
        writer.add_frame(0.0, cloud=cloud)
    frame = read_recording(tmp_path / "r").frames[0]
    assert not frame.depth
    np.testing.assert_array_equal(read_cloud(frame.cloud), cloud)


def test_what_is_no_depth_is_written_as_no_measurement(tmp_path, camera):
    depth = np.full((48, 64), 0.5)
    depth[0, :5] = [np.nan, np.inf, -1.0, 65.536, 65.535]
    with RecordingWriter(tmp_path / "r", [camera], {"top": 0.001}) as writer:
        writer.add_frame(0.0, depth={"top": depth})
    back = read_depth(tmp_path / "r/depth/000000.png", 0.001)
    np.testing.assert_allclose(back[0, :6], [0, 0, 0, 0, 65.535, 0.5], rtol=1e-6)


def test_nothing_is_left_when_the_recording_breaks_off(tmp_path, camera):
    def record():
        with RecordingWriter(tmp_path / "r", [camera], {"top": 0.001}) as writer:
            writer.add_frame(0.0, depth={"top": np.full((48, 64), 0.5)})
            assert not (tmp_path / "r").exists()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_a_storage_error_and_leaves_nothing(tmp_path, camera, monkeypatch):
    def full(path, data):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)

    def record():
        with RecordingWriter(tmp_path / "r", [camera], {"top": 0.001}) as writer:
            writer.add_frame(0.0, depth={"top": np.full((48, 64), 0.5)})

    with pytest.raises(StorageError, match=r"depth/000000\.png: the disk is full; free some space"):
        record()
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_never_touched(tmp_path, camera):
    (tmp_path / "r").mkdir()
    with pytest.raises(StorageError, match="exists; delete it or write to another name"):
        RecordingWriter(tmp_path / "r", [camera], {})
    assert list(tmp_path.iterdir()) == [tmp_path / "r"]


def test_the_writer_does_not_finish_an_invalid_recording(tmp_path, camera):
    def record():
        with RecordingWriter(tmp_path / "r", [camera], {"top": 0.001}) as writer:
            for frame in range(2):
                writer.add_frame(0.1 * frame, depth={"top": np.full((48, 64), 0.5)})
            writer.add_action(0, 1, ["arm"])

    with pytest.raises(InvalidRecordingError, match=r"actions\[0\]\.pickers"):
        record()
    assert list(tmp_path.iterdir()) == []


def test_frames_are_checked_as_they_come(tmp_path, camera):
    depth = np.full((48, 64), 0.5)
    path = PickerPath(np.zeros(1), np.zeros((1, 3)), np.zeros(1, dtype=bool))
    with RecordingWriter(tmp_path / "r", [camera], {"top": 0.001}) as writer:
        writer.add_frame(0.0, depth={"top": depth})
        with pytest.raises(InvalidRecordingError, match="not after"):
            writer.add_frame(0.0, depth={"top": depth})
        with pytest.raises(InvalidRecordingError, match="time_s is nan"):
            writer.add_frame(float("nan"), depth={"top": depth})
        with pytest.raises(InvalidRecordingError, match="48 x 64 pixels from camera 'top'"):
            writer.add_frame(1.0, depth={"top": depth.T})
        with pytest.raises(InvalidRecordingError, match="no camera 'side'"):
            writer.add_frame(1.0, depth={"side": depth})
        with pytest.raises(InvalidRecordingError, match="no spaces, commas"):
            writer.set_picker_path("left, arm", path)
    assert len(read_recording(tmp_path / "r").frames) == 1


def test_a_signal_does_not_break_off_the_removal_of_a_half_written_recording(
    tmp_path, camera, monkeypatch
):
    """A worker that is ended is told so more than once, also while it clears away."""
    remove = shutil.rmtree

    def told_again(*arguments, **options):
        os.kill(os.getpid(), signal.SIGTERM)
        remove(*arguments, **options)

    def leave(number, frame):
        raise SystemExit(1)

    monkeypatch.setattr(shutil, "rmtree", told_again)
    before = signal.signal(signal.SIGTERM, leave)
    try:
        with pytest.raises(SystemExit), RecordingWriter(tmp_path / "r", [camera], {"top": 1e-3}):
            raise SystemExit(1)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert not list(tmp_path.iterdir())
