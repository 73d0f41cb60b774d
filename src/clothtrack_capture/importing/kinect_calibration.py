"""The factory calibration of an Azure Kinect or Orbbec Femto, for each recording mode.

The JSON holds each camera's intrinsics for its full sensor, as shares of the sensor's sides, with
the first pixel's outer corner at (0, 0). A mode bins and crops the sensor. OpenCV's origin is the
center of the first pixel. (Modes as in the Azure Kinect Sensor SDK, `mode_specific_calibration.c`.)
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import rigid_problem
from clothtrack_capture.importing.intrinsics import Intrinsics

# Per picture size: the sensor after binning and the first pixel of the crop, (along x, along y).
# No two depth modes have the same size: narrow binned, narrow, wide binned, wide.
_DEPTH_MODES = {
    (320, 288): ((512, 512), (96, 90)),
    (640, 576): ((1024, 1024), (192, 180)),
    (512, 512): ((512, 512), (0, 0)),
    (1024, 1024): ((1024, 1024), (0, 0)),
}
_COLOR_MODES = {
    (1280, 720): ((1280, 960), (0, 120)),
    (1920, 1080): ((1920, 1440), (0, 180)),
    (2560, 1440): ((2560, 1920), (0, 240)),
    (2048, 1536): ((2048, 1536), (0, 0)),
    (3840, 2160): ((3840, 2880), (0, 360)),
    (4096, 3072): ((4096, 3072), (0, 0)),
}
# Old calibrations are for a 16:9 picture cropped from the 4:3 sensor.
_LEGACY = ((4096, 2304), (0, -384), (4096, 3072))
_DEPTH_PLACE, _COLOR_PLACE = "CALIBRATION_CameraLocationD0", "CALIBRATION_CameraLocationPV0"
_MODEL = "CALIBRATION_LensDistortionModelBrownConrady"


def kinect_intrinsics(
    path: Path, text: bytes, depth_size: tuple[int, int], color_size: tuple[int, int] | None
) -> tuple[Intrinsics, Intrinsics | None, Float[np.ndarray, "4 4"]]:
    """Return the intrinsics of depth and color and the transform from depth to color camera [m].

    Args:
        path: path of the recording, for error messages.
        text: calibration as JSON.
        depth_size: width and height of the depth pictures [pixels].
        color_size: width and height of the color pictures [pixels]; None without color.
    """
    for what, size, modes in (
        ("depth", depth_size, _DEPTH_MODES), ("color", color_size, _COLOR_MODES)
    ):  # fmt: skip
        if size is not None and size not in modes:
            known = ", ".join(f"{width} x {height}" for width, height in modes)
            raise InvalidRecordingError(
                f"{path}: {what} pictures of {size[0]} x {size[1]} pixels; the sensor's modes have "
                f"{known}; give the intrinsics with --intrinsics FILE"
            )
    try:
        cameras = json.loads(text.split(b"\0")[0])["CalibrationInformation"]["Cameras"]
        by_place = {camera["Location"]: camera for camera in cameras}
        depth = _intrinsics(
            by_place[_DEPTH_PLACE], *_DEPTH_MODES[depth_size], depth_size, legacy=False
        )
        if color_size is None:
            return depth, None, np.eye(4)
        color = _intrinsics(
            by_place[_COLOR_PLACE], *_COLOR_MODES[color_size], color_size, legacy=True
        )
        pose = _pose(by_place[_COLOR_PLACE]) @ np.linalg.inv(_pose(by_place[_DEPTH_PLACE]))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError) as error:
        raise InvalidRecordingError(
            f"{path}: the attached calibration is damaged ({type(error).__name__}: {error}); give "
            "the intrinsics with --intrinsics FILE"
        ) from error
    return depth, color, pose


def _intrinsics(
    camera: dict[str, Any],
    binned: tuple[int, int],
    crop: tuple[int, int],
    size: tuple[int, int],
    *,
    legacy: bool,
) -> Intrinsics:
    intrinsics = camera["Intrinsics"]
    if intrinsics["ModelType"] != _MODEL:
        raise ValueError(f"lens model {intrinsics['ModelType']}")
    numbers = [float(parameter) for parameter in intrinsics["ModelParameters"]]
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = numbers
    width, height = int(camera["SensorWidth"]), int(camera["SensorHeight"])
    if legacy and width * 9 == height * 16:
        (across, down), (left, above), (full_width, full_height) = _LEGACY
        cx, fx = (cx * across - left) / full_width, fx * across / full_width
        cy, fy = (cy * down - above) / full_height, fy * down / full_height
    return Intrinsics(
        *size,
        fx * binned[0],
        fy * binned[1],
        cx * binned[0] - crop[0] - 0.5,
        cy * binned[1] - crop[1] - 0.5,
        (k1, k2, p1, p2, k3, k4, k5, k6),
    )


def _pose(camera: dict[str, Any]) -> Float[np.ndarray, "4 4"]:
    """Return the transform from the device to this camera [m]."""
    result = np.eye(4)
    result[:3, :3] = np.array(camera["Rt"]["Rotation"], dtype=np.float64).reshape(3, 3)
    result[:3, 3] = np.array(camera["Rt"]["Translation"], dtype=np.float64)
    if problem := rigid_problem(result):
        raise ValueError(f"Rt {problem}")
    return result
