"""Capture: recording, import, camera calibration, masks and picker paths.

This package imports `clothtrack`, which does not import it.
"""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.recordings.recorded_table import fit_recorded_table
    from clothtrack_capture.api.calibration import calibrate_camera
    from clothtrack_capture.api.live_ros2 import live_ros2
    from clothtrack_capture.api.picker import find_picker
    from clothtrack_capture.api.recording import import_recording, record
    from clothtrack_capture.api.segmentation import segment
    from clothtrack_capture.board import Board, BoardPose, locate_board, locate_boards
    from clothtrack_capture.hand_eye import HandEye, RobotPose, calibrate_hand_eye, read_robot_poses
    from clothtrack_capture.importing.import_options import ImportOptions
    from clothtrack_capture.live_capture import (
        CapturedFrame,
        CaptureWriter,
        DepthCamera,
        ReplayedCamera,
    )
    from clothtrack_capture.realsense_camera import RealSenseCamera, open_realsense
    from clothtrack_capture.segmentation_setup import SegmentationSetup
    from clothtrack_capture.tip_finder import TipFinder
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "Board",
    "BoardPose",
    "CaptureWriter",
    "CapturedFrame",
    "DepthCamera",
    "HandEye",
    "ImportOptions",
    "RealSenseCamera",
    "ReplayedCamera",
    "RobotPose",
    "SegmentationSetup",
    "TipFinder",
    "calibrate_camera",
    "calibrate_hand_eye",
    "find_picker",
    "fit_recorded_table",
    "import_recording",
    "live_ros2",
    "locate_board",
    "locate_boards",
    "open_realsense",
    "read_robot_poses",
    "record",
    "segment",
]
