"""From a sensor or a file to a recording: recording, import, calibration, masks, picker paths.

This package imports `clothtrack`, which does not import it.
"""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.recordings.recorded_table import fit_recorded_table
    from clothtrack_capture.board import Board, BoardPose, locate_board, locate_boards
    from clothtrack_capture.franka import FrankaConfig, FrankaRobot, FrankyArm
    from clothtrack_capture.hand_eye import HandEye, RobotPose, calibrate_hand_eye, read_robot_poses
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
    "FrankaConfig",
    "FrankaRobot",
    "FrankyArm",
    "HandEye",
    "RealSenseCamera",
    "ReplayedCamera",
    "RobotPose",
    "SegmentationSetup",
    "TipFinder",
    "calibrate_hand_eye",
    "fit_recorded_table",
    "locate_board",
    "locate_boards",
    "open_realsense",
    "read_robot_poses",
]
