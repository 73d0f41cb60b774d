"""Live Intel RealSense cameras through pyrealsense2 (extra [realsense]), with aligned depth."""

import logging
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.files.extras import install_command
from clothtrack.geometry.camera import Camera
from clothtrack_capture.live_capture import CapturedFrame

logger = logging.getLogger(__name__)

_WAIT_MS = 5000
_NOTICEABLE_PX = 0.5


class RealSenseCamera:
    """A RealSense camera: `rs.pipeline`, or `rs.syncer` behind a software device."""

    def __init__(self, source: Any, *, pipeline: Any = None, name: str = "top") -> None:
        """Wait for the first frames to read the intrinsics; `close` stops the pipeline."""
        rs = _sdk()
        self._source, self._pipeline = source, pipeline
        self._align = rs.align(rs.stream.color)
        first = self._next()
        if first is None:
            raise InvalidRecordingError(
                "the camera gives no depth together with color; switch both streams on"
            )
        depth, color = first
        lens = color.get_profile().as_video_stream_profile().get_intrinsics()
        self.camera = Camera(name, lens.width, lens.height, lens.fx, lens.fy, lens.ppx, lens.ppy)
        # The unit is a single-precision number, which holds seven digits.
        self.depth_unit_m = float(f"{depth.get_units():.7g}")
        self._warn_of_distortion(lens)

    def frames(self) -> Iterator[CapturedFrame]:
        """Yield frames as they arrive, until the camera stops sending or its file ends."""
        while (found := self._next()) is not None:
            depth, color = found
            counts = np.asanyarray(depth.get_data())
            yield CapturedFrame(
                depth.get_timestamp() / 1000.0,
                np.asanyarray(color.get_data()).copy(),
                counts.astype(np.float32) * np.float32(self.depth_unit_m),
            )

    def close(self) -> None:
        """Stop the pipeline, if there is one."""
        if self._pipeline is not None:
            self._pipeline.stop()

    def _next(self) -> tuple[Any, Any] | None:
        """Return depth aligned to color, and color; None if no more frames come."""
        for _ in range(30):
            try:
                frames = self._source.wait_for_frames(_WAIT_MS)
            except RuntimeError as error:
                logger.info("no more frames: %s", error)
                return None
            # The first sets of a stream may lack one of the two.
            if frames.get_depth_frame() and frames.get_color_frame():
                laid = self._align.process(frames)
                return laid.get_depth_frame(), laid.get_color_frame()
        return None

    def _warn_of_distortion(self, lens: Any) -> None:
        """Warn if the lens distorts the picture's corner, because recordings have no distortion."""
        coefficients = np.array(lens.coeffs, dtype=float)
        x, y = (0 - lens.ppx) / lens.fx, (0 - lens.ppy) / lens.fy
        r2 = x * x + y * y
        bend = coefficients[0] * r2 + coefficients[1] * r2**2 + coefficients[4] * r2**3
        off = abs(bend) * float(np.hypot(x * lens.fx, y * lens.fy))
        if off > _NOTICEABLE_PX:
            logger.warning(
                "the lens bends the corner of the picture by about %.1f pixels; this is not "
                "undone", off,
            )  # fmt: skip


def open_realsense(
    *, width: int = 640, height: int = 480, rate: int = 30, serial: str = "", name: str = "top"
) -> RealSenseCamera:
    """Start a connected RealSense camera.

    Args:
        width: width of both pictures [pixels].
        height: height of both pictures [pixels].
        rate: pictures per second.
        serial: serial number of the camera, if several are connected.
        name: name of the camera in the recording.

    Raises:
        InvalidConfigError: pyrealsense2 is not installed, or no camera offers this format.
    """
    rs = _sdk()
    config, pipeline = rs.config(), rs.pipeline()
    if serial:
        config.enable_device(serial)
    config.enable_stream(rs.stream.depth, width, height, rs.format.z16, rate)
    config.enable_stream(rs.stream.color, width, height, rs.format.rgb8, rate)
    try:
        # Without this check the SDK waits a quarter of a minute for a camera to be plugged in.
        if not len(rs.context().query_devices()):
            raise RuntimeError("none is connected")
        pipeline.start(config)
    except RuntimeError as error:
        raise InvalidConfigError(
            f"no RealSense camera gives {width} x {height} pixels at {rate}/s ({error}); plug it "
            "in (USB 3), close other programs that use it, or choose another size or rate"
        ) from error
    try:
        return RealSenseCamera(pipeline, pipeline=pipeline, name=name)
    except InvalidRecordingError:
        pipeline.stop()
        raise


def _sdk() -> Any:
    try:
        return import_module("pyrealsense2")
    except ImportError as error:
        raise InvalidConfigError(
            "recording from a RealSense camera needs pyrealsense2; install with: "
            f"{install_command('realsense')}"
        ) from error
