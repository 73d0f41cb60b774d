"""How every experiment calls the tracker: one recording, one named mode, one stored result."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.errors import ClothTrackError
from clothtrack.tracking import MODES, RunConfig, TrackedTrajectory, mode, track_recordings
from clothtrack.tracking.flat_fit import InitialStateConfig

MODE_NAMES = tuple(MODES)


def track(
    recording: Path,
    mode_name: str,
    output: Path,
    *,
    vertex_count: int = 1000,
    calibrated: bool = True,
    device: str = "cpu",
) -> TrackedTrajectory:
    """Track a recording in a named mode; the result is kept in OUTPUT/MODE/NAME.zarr.

    A result that lies there from the same settings is read instead.

    Args:
        recording: its folder.
        mode_name: one of `MODE_NAMES`.
        output: folder of the results.
        vertex_count: of the first mesh, when the recording has no template.
        calibrated: False skips the search for cloth parameters (smoke runs).
        device: "cpu" or "cuda:0".

    Raises:
        ClothTrackError: what was wrong with the recording.
    """
    tracker = mode(mode_name)
    if not calibrated:
        tracker = replace(tracker, calibration=replace(tracker.calibration, method="none"))
    config = RunConfig(tracker=tracker, initial_state=InitialStateConfig(vertex_count=vertex_count))
    (outcome,) = track_recordings([recording], output / mode_name, config, device=device)
    if outcome.result is None:
        raise ClothTrackError(outcome.error)
    return TrackedTrajectory.load(outcome.result)


def before_final_alignment(
    tracked: TrackedTrajectory,
) -> Float[np.ndarray, "frames vertices 3"]:
    """Positions [m] as the paper scores them: at the end of an action, before TTO2."""
    positions = np.array(tracked.positions, dtype=np.float64)
    for action in tracked.actions:
        positions[action.last_frame] = action.positions_before_final_alignment
    return positions
