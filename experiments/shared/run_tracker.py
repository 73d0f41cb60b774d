"""The call of the tracker in all experiments on real recordings: one recording, one method."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.recordings.identity import DIGEST_FIELD, recording_digest
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.configuration import MODES, InitialStateConfig
from clothtrack.tracking.pipeline import config_hash, result_path, track_recording
from clothtrack.tracking.search import SearchConfig
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory
from shared.ablations import PAPER, settings_of

MODE_NAMES = (*MODES, *PAPER)


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

    A result that lies there from the same recording and settings is read instead.
    """
    config = replace(
        settings_of(mode_name), initial_state=InitialStateConfig(vertex_count=vertex_count)
    )
    if not calibrated:
        config = replace(config, search=SearchConfig(method="none"))
    source, path = read_recording(recording), result_path(recording, output / mode_name)
    if path.exists():
        kept = TrackedTrajectory.load(path)
        known = kept.provenance.get(DIGEST_FIELD), kept.provenance.get("config_hash")
        if known == (recording_digest(source), config_hash(config)):
            return kept
    tracked = track_recording(source, config, device=device, assemble=PAPER.get(mode_name))
    path.parent.mkdir(parents=True, exist_ok=True)
    tracked.save(path)
    return tracked


def before_final_alignment(
    tracked: TrackedTrajectory,
) -> Float[np.ndarray, "frames vertices 3"]:
    """Return positions [m] as the paper scores them: at the end of an action, before TTO2."""
    positions = np.array(tracked.positions, dtype=np.float64)
    for action in tracked.actions:
        positions[action.last_frame] = action.positions_before_final_alignment
    return positions
