"""Algorithm 1 of the paper: calibration, alignment, line search."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.tracking.configuration import (
        MODES,
        ClothConfig,
        InitialStateConfig,
        ObjectiveConfig,
        RunConfig,
        mode,
    )
    from clothtrack.tracking.initial_state import find_initial_state
    from clothtrack.tracking.methods import METHODS, Assembled, Components
    from clothtrack.tracking.pipeline import (
        Outcome,
        result_path,
        track_recording,
        track_recordings,
    )
    from clothtrack.tracking.protocols import (
        Candidate,
        Corrected,
        Correction,
        Dynamics,
        Grasps,
        Method,
        Prediction,
        Search,
        State,
        TrackedCandidate,
    )
    from clothtrack.tracking.search import SearchConfig
    from clothtrack.tracking.theta import Theta
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
    "METHODS",
    "MODES",
    "Assembled",
    "Calibration",
    "Candidate",
    "ClothConfig",
    "Components",
    "Corrected",
    "Correction",
    "Dynamics",
    "Grasps",
    "InitialStateConfig",
    "Method",
    "ObjectiveConfig",
    "Outcome",
    "Prediction",
    "RunConfig",
    "Search",
    "SearchConfig",
    "State",
    "StepRecords",
    "Theta",
    "TrackedAction",
    "TrackedCandidate",
    "TrackedTrajectory",
    "Tracker",
    "find_initial_state",
    "mode",
    "result_path",
    "track_recording",
    "track_recordings",
]
