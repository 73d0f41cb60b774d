"""RealSense cameras through the SDK's own software device; skipped where there is no SDK."""

import subprocess
import sys

import numpy as np
import pytest

import clothtrack as ct
from clothtrack.errors import InvalidConfigError
from clothtrack.files.extras import install_command
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack_capture.live_capture import CaptureWriter
from clothtrack_capture.realsense_camera import RealSenseCamera, open_realsense

WIDTH, HEIGHT, FOCAL = 160, 120, 150.0


class SoftwareDevice:
    """A software device that gives a frameset whenever it is asked, as a pipeline does."""

    def __init__(self, rs, frames):
        self._rs, self._left, self._number = rs, frames, 0
        self._device = rs.software_device()
        self._sensors = [self._device.add_sensor(name) for name in ("Depth", "Color")]
        self._profiles = [
            sensor.add_video_stream(self._stream(place))
            for place, sensor in enumerate(self._sensors)
        ]
        self._sensors[0].add_read_only_option(rs.option.depth_units, 0.001)
        still = rs.extrinsics()
        still.rotation, still.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0.0, 0.0, 0.0]
        self._profiles[0].register_extrinsics_to(self._profiles[1], still)
        self._device.create_matcher(rs.matchers.dlr_c)
        self._syncer = rs.syncer()
        for sensor, profile in zip(self._sensors, self._profiles, strict=True):
            sensor.open(profile)
            sensor.start(self._syncer)

    def wait_for_frames(self, timeout_ms):
        if self._left == 0:
            raise RuntimeError("Frame didn't arrive")
        self._left -= 1
        self._number += 1
        for place, picture in enumerate(drawn(self._number)):
            frame = self._rs.software_video_frame()
            frame.pixels, frame.bpp = picture, (2, 3)[place]
            frame.stride, frame.timestamp = WIDTH * frame.bpp, 1000.0 * self._number / 30.0
            frame.domain = self._rs.timestamp_domain.hardware_clock
            frame.frame_number = self._number
            frame.profile = self._profiles[place].as_video_stream_profile()
            if place == 0:
                frame.depth_units = 0.001
            self._sensors[place].on_video_frame(frame)
        return self._syncer.wait_for_frames(2000)

    def close(self):
        for sensor in self._sensors:
            sensor.stop()
            sensor.close()

    def _stream(self, place):
        rs, stream, lens = self._rs, self._rs.video_stream(), self._rs.intrinsics()
        lens.width, lens.height, lens.fx, lens.fy = WIDTH, HEIGHT, FOCAL, FOCAL
        lens.ppx, lens.ppy = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
        lens.model, lens.coeffs = rs.distortion.none, [0.0] * 5
        stream.type = (rs.stream.depth, rs.stream.color)[place]
        stream.fmt = (rs.format.z16, rs.format.rgb8)[place]
        stream.index, stream.uid, stream.fps, stream.bpp = 0, place, 30, (2, 3)[place]
        stream.width, stream.height, stream.intrinsics = WIDTH, HEIGHT, lens
        return stream


def drawn(number):
    depth = np.full((HEIGHT, WIDTH), 700 + number, np.uint16)
    color = np.full((HEIGHT, WIDTH, 3), (20 * number, 50, 100), np.uint8)
    color[40:80, 60:100] = (200, 10, 10)
    return depth, color


def test_a_software_device_is_recorded_value_by_value(tmp_path):
    rs = pytest.importorskip("pyrealsense2")
    device = SoftwareDevice(rs, 10)
    try:
        source = RealSenseCamera(device)
        assert (source.camera.width, source.camera.height) == (WIDTH, HEIGHT)
        assert source.camera.fx == FOCAL
        assert source.depth_unit_m == 0.001
        writer = CaptureWriter(tmp_path / "film", source, {"camera": "software"})
        for frame in source.frames():
            writer.add(frame)
        source.close()
        recording = writer.finish()
    finally:
        device.close()
    assert len(recording.frames) >= 7
    for frame in recording.frames:
        color = read_color(frame.color["top"])
        number = int(color[0, 0, 0]) // 20
        np.testing.assert_array_equal(color, drawn(number)[1])
        depth = read_depth(frame.depth["top"], 0.001)
        # The SDK lays depth on the grid of the color camera, which leaves some pixels out.
        assert (depth > 0).mean() > 0.9
        np.testing.assert_allclose(depth[depth > 0], 0.7 + 0.001 * number, atol=1e-6)
    steps = np.diff([frame.time_s for frame in recording.frames])
    np.testing.assert_allclose(steps, 1 / 30, atol=1e-4)


@pytest.mark.slow
def test_a_software_device_is_tracked_live():
    device = SoftwareDevice(pytest.importorskip("pyrealsense2"), 10)
    states = []
    try:
        source = RealSenseCamera(device)
        frames = source.frames()
        tracker = ct.LiveTracker(
            ct.ClothDescription("towel", "red"), source.camera, table="find", force=True
        )
        with ct.LiveStream(tracker, states.append) as stream:
            for frame in frames:
                stream.put(frame.time_s, frame.depth_m, frame.color)
        source.close()
    finally:
        device.close()
    assert states
    spans = np.ptp(states[0].positions, axis=0)  # of 40 pixels of cloth at 0.7 m
    np.testing.assert_allclose(spans[:2], 40 * 0.7 / FOCAL, rtol=0.15)


def test_without_a_camera_the_message_says_what_to_do():
    pytest.importorskip("pyrealsense2")
    with pytest.raises(InvalidConfigError, match="plug it in"):
        open_realsense()


WITHOUT = """
import sys
sys.modules["pyrealsense2"] = None
from clothtrack.cli.command_line import main
sys.exit(main(["record", sys.argv[1]]))
"""


def test_without_the_sdk_the_extra_is_named(tmp_path):
    told = subprocess.run(
        [sys.executable, "-c", WITHOUT, str(tmp_path / "film")],
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert told.returncode == 1
    assert install_command("realsense") in told.stderr
    assert not list(tmp_path.iterdir())
