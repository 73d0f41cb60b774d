"""Find results of earlier commands by name: tracked trajectories and their recordings."""

import logging
from pathlib import Path
from typing import TYPE_CHECKING

from clothtrack.errors import InvalidRecordingError, InvalidResultError

if TYPE_CHECKING:
    from clothtrack.recordings.recording import Recording
    from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

logger = logging.getLogger(__name__)


def load_tracked(path: Path) -> "TrackedTrajectory":
    """Return a tracked trajectory."""
    from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

    if not path.exists():
        raise InvalidResultError(f"{path}: there is no such tracked trajectory; check the name")
    return TrackedTrajectory.load(path)


def require_own(
    tracked: "TrackedTrajectory", recording: "Recording", *, artifact: Path, folder: Path
) -> None:
    """Refuse a recording of another name and content than the trajectory was tracked from."""
    if recording.name != tracked.name and not _is_unchanged(tracked, recording):
        raise InvalidRecordingError(
            f"{folder}: is recording {recording.name}, and {artifact} was tracked from "
            f"{tracked.name}; give that one"
        )


def warn_of_age(
    tracked: "TrackedTrajectory", recording: "Recording", *, artifact: Path, folder: Path
) -> None:
    """Warn if a recording was changed since it was tracked, or is another one of the same name."""
    if not _is_unchanged(tracked, recording):
        logger.warning(
            "%s is older than its recording %s (which was changed since, or is another one); "
            "track it again",
            artifact,
            folder,
        )


def _is_unchanged(tracked: "TrackedTrajectory", recording: "Recording") -> bool:
    """Return whether a recording has the content that the trajectory was tracked from."""
    from clothtrack.recordings.identity import DIGEST_FIELD, recording_digest

    digest = recording_digest(recording)
    return tracked.provenance.get(DIGEST_FIELD, digest) == digest


def recording_folder(tracked: "TrackedTrajectory", path: Path) -> Path:
    """Return the path if it is a recording, else the recording of this name in that folder."""
    return path if (path / "recording.json").exists() else inside(path, tracked.name)


def inside(path: Path, name: str) -> Path:
    """Return the entry of a folder, or the path itself when it is a file."""
    return path / name if path.is_dir() else path
