"""Making a recording: filming, the camera's pose, which pixels are cloth, where the picker is."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.capture.board import Board, BoardPose, locate_board, locate_boards
    from clothtrack.capture.hand_eye import HandEye, RobotPose, calibrate_hand_eye, read_robot_poses
    from clothtrack.capture.live_capture import (
        CapturedFrame,
        CaptureWriter,
        DepthCamera,
        ReplayedCamera,
    )
    from clothtrack.capture.realsense_camera import RealSenseCamera, open_realsense
    from clothtrack.capture.segmentation_setup import SegmentationSetup
    from clothtrack.capture.tip_finder import TipFinder
    from clothtrack.recordings.recorded_table import fit_recorded_table
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "Board",
    "BoardPose",
    "CaptureWriter",
    "CapturedFrame",
    "DepthCamera",
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
