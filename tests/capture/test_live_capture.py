"""Live capture: frames are on disk as they come, and a killed process loses those of a second."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError, StorageError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.store import read_recording
from clothtrack_capture import live_capture as capture
from clothtrack_capture.live_capture import (
    CapturedFrame,
    CaptureWriter,
    ReplayedCamera,
    capture_folder,
)

CAMERA = Camera("top", 64, 48, 60.0, 60.0, 31.5, 23.5)


class Drawn:
    """A camera that draws its frames."""

    camera, depth_unit_m = CAMERA, 0.001

    def frames(self):
        for number in range(10):
            yield picture(number)

    def close(self):
        """Nothing."""


def picture(number, *, color=True):
    rng = np.random.default_rng(number)
    return CapturedFrame(
        100.0 + number / 30.0,
        rng.integers(0, 256, (48, 64, 3), dtype=np.uint8) if color else None,
        rng.integers(400, 900, (48, 64)) / 1000.0,
    )


def captured(target, count=10):
    writer = CaptureWriter(target, Drawn(), {"by": "test"})
    for number in range(count):
        writer.add(picture(number))
    return writer


def test_what_the_camera_gave_is_in_the_recording(tmp_path):
    writer = CaptureWriter(tmp_path / "film", Drawn(), {"by": "test"})
    writer.mark("flat")
    for number in range(10):
        writer.add(picture(number))
    recording = writer.finish()
    assert len(recording.frames) == 10
    assert recording.frames[0].time_s == 0.0
    assert recording.frames[9].time_s == pytest.approx(0.3, abs=1e-5)
    for number, frame in enumerate(recording.frames):
        np.testing.assert_array_equal(read_color(frame.color["top"]), picture(number).color)
        np.testing.assert_allclose(
            read_depth(frame.depth["top"], 0.001), picture(number).depth_m, atol=1e-6
        )
    assert recording.provenance == {"by": "test", "marks": [["flat", 0]]}
    assert [path.name for path in tmp_path.iterdir()] == ["film"]


def test_depth_alone_can_be_recorded(tmp_path):
    writer = CaptureWriter(tmp_path / "film", Drawn(), {})
    writer.add(picture(0, color=False))
    recording = writer.finish()
    assert not recording.frames[0].color
    assert not (tmp_path / "film" / "color").exists()


def test_a_clock_that_stands_still_and_a_blind_camera_drop_the_frame(tmp_path):
    writer = CaptureWriter(tmp_path / "film", Drawn(), {})
    for number in (0, 1, 1, 0, 2):
        writer.add(picture(number))
    writer.add(replace(picture(3), depth_m=np.zeros((48, 64))))
    assert len(writer.finish().frames) == 3
    assert writer.state.dropped == 3


def test_nothing_recorded_leaves_nothing(tmp_path):
    writer = CaptureWriter(tmp_path / "film", Drawn(), {})
    with pytest.raises(InvalidRecordingError, match="no frame with depth"):
        writer.finish()
    assert not list(tmp_path.iterdir())


def test_pictures_of_another_size_make_no_recording(tmp_path):
    writer = CaptureWriter(tmp_path / "film", Drawn(), {})
    writer.add(replace(picture(0, color=False), depth_m=np.ones((24, 32))))
    with pytest.raises(InvalidRecordingError, match="32"):
        writer.finish()
    assert not (tmp_path / "film").exists()


def test_a_disk_that_is_too_slow_drops_frames_and_counts_them(tmp_path, monkeypatch):
    monkeypatch.setattr(capture, "WAITING_FRAMES", 2)
    slow = capture.encode_png
    monkeypatch.setattr(capture, "encode_png", lambda image: (time.sleep(0.02), slow(image))[1])
    writer = captured(tmp_path / "film", 20)
    recording = writer.finish()
    assert len(recording.frames) + writer.state.dropped == 20
    assert writer.state.dropped > 5


def test_a_full_disk_is_said_and_what_was_written_can_be_renamed(tmp_path, monkeypatch):
    encode, count = capture.encode_png, [0]

    def filling(image):
        count[0] += 1
        if count[0] > 9:
            raise OSError(28, "No space left on device", "depth")
        return encode(image)

    monkeypatch.setattr(capture, "encode_png", filling)
    writer = captured(tmp_path / "film")
    with pytest.raises(StorageError, match=r"the disk is full.*rename .*film.capture .* 4 frames"):
        writer.finish()
    assert not (tmp_path / "film").exists()
    assert (
        len(read_recording(capture_folder(tmp_path / "film").rename(tmp_path / "kept")).frames) == 4
    )


def test_nothing_is_overwritten(tmp_path):
    captured(tmp_path / "film").finish()
    with pytest.raises(StorageError, match="exists; delete it or record to another name"):
        CaptureWriter(tmp_path / "film", Drawn(), {})
    writer = CaptureWriter(tmp_path / "other", Drawn(), {})
    with pytest.raises(StorageError, match="rename it to keep its frames"):
        CaptureWriter(tmp_path / "other", Drawn(), {})
    writer.add(picture(0))
    writer.finish()


PLUGGED = """
import sys, time
from pathlib import Path
import numpy as np
from clothtrack.geometry.camera import Camera
from clothtrack_capture.live_capture import CapturedFrame, CaptureWriter

class Source:
    camera, depth_unit_m = Camera("top", 64, 48, 60.0, 60.0, 31.5, 23.5), 0.001

writer = CaptureWriter(Path(sys.argv[1]), Source(), {})
for number in range(100000):
    depth = np.full((48, 64), 0.5 + 0.001 * (number % 100))
    writer.add(CapturedFrame(number / 100.0, np.full((48, 64, 3), number % 256, np.uint8), depth))
    time.sleep(0.002)
    print(writer.state.written, flush=True)
"""


def test_a_killed_process_loses_the_frames_of_a_second(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", PLUGGED, str(tmp_path / "film")], stdout=subprocess.PIPE, text=True
    ) as process:
        written = 0
        for line in process.stdout:
            written = int(line)
            if written >= 70:
                os.kill(process.pid, signal.SIGKILL)
                break
    assert written >= 70
    assert not (tmp_path / "film").exists()
    recording = read_recording(capture_folder(tmp_path / "film").rename(tmp_path / "film"))
    assert len(recording.frames) > written - capture._LISTED_EVERY
    for frame in recording.frames:
        number = round(100.0 * frame.time_s)
        assert (read_color(frame.color["top"]) == number % 256).all()


def test_a_recording_stands_in_for_a_camera(tmp_path):
    source = ReplayedCamera(captured(tmp_path / "film").finish(), speed=float("inf"))
    writer = CaptureWriter(tmp_path / "copy", source, {})
    for frame in source.frames():
        writer.add(frame)
    copy = writer.finish()
    assert len(copy.frames) == 10
    original = json.loads((tmp_path / "film" / "recording.json").read_text())
    again = json.loads((tmp_path / "copy" / "recording.json").read_text())
    assert again["cameras"] == original["cameras"]
    for kind in ("color", "depth"):
        for file in sorted((tmp_path / "film" / kind).iterdir()):
            assert (tmp_path / "copy" / kind / file.name).read_bytes() == file.read_bytes()
