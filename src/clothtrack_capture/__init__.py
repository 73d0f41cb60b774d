"""Capture: recording, import, camera calibration, masks and picker paths.

This package imports `clothtrack`, which does not import it.
"""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack_capture.api.calibration import calibrate_camera
    from clothtrack_capture.api.live_ros2 import live_ros2
    from clothtrack_capture.api.picker import find_picker
    from clothtrack_capture.api.recording import import_recording, record
    from clothtrack_capture.api.segmentation import segment
    from clothtrack_capture.importing.import_options import ImportOptions
    from clothtrack_capture.live_capture import CapturedFrame, DepthCamera
    from clothtrack_capture.realsense_camera import open_realsense
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "CapturedFrame",
    "DepthCamera",
    "ImportOptions",
    "calibrate_camera",
    "find_picker",
    "import_recording",
    "live_ros2",
    "open_realsense",
    "record",
    "segment",
]
