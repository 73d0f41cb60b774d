"""The contribution of the paper: calibration, alignment, line search, Algorithm 1."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.tracking.configuration import MODES, TrackerConfig, mode
    from clothtrack.tracking.initial_state import find_initial_state
    from clothtrack.tracking.pipeline import (
        Outcome,
        RunConfig,
        result_path,
        track_recording,
        track_recordings,
    )
    from clothtrack.tracking.seams import (
        Aligner,
        AlignLast,
        Calibrate,
        Corrected,
        Correction,
        Dyn,
        Dynamics,
        Grasps,
        LineSearch,
        Parts,
        Pick,
        Prediction,
    )
    from clothtrack.tracking.tracked_trajectory import (
        Calibration,
        StepRecords,
        TrackedAction,
        TrackedTrajectory,
    )
    from clothtrack.tracking.tracker import Tracker
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "MODES",
    "AlignLast",
    "Aligner",
    "Calibrate",
    "Calibration",
    "Corrected",
    "Correction",
    "Dyn",
    "Dynamics",
    "Grasps",
    "LineSearch",
    "Outcome",
    "Parts",
    "Pick",
    "Prediction",
    "RunConfig",
    "StepRecords",
    "TrackedAction",
    "TrackedTrajectory",
    "Tracker",
    "TrackerConfig",
    "find_initial_state",
    "mode",
    "result_path",
    "track_recording",
    "track_recordings",
]
