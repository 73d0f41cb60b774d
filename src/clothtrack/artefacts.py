"""What an earlier verb has left, found by name: tracked trajectories and their recordings."""

from pathlib import Path
from typing import TYPE_CHECKING

from clothtrack.errors import InvalidResultError

if TYPE_CHECKING:
    from clothtrack.recordings.recording import Recording
    from clothtrack.tracking.tracked_trajectory import TrackedTrajectory


def load_tracked(path: Path) -> "TrackedTrajectory":
    """A tracked trajectory.

    Raises:
        InvalidResultError: it is missing or unfinished.
    """
    from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

    if not path.exists():
        raise InvalidResultError(f"{path}: there is no such tracked trajectory; check the name")
    return TrackedTrajectory.load(path)


def recording_of(tracked: "TrackedTrajectory", path: Path) -> "Recording":
    """The recording that was tracked: the folder itself, or the one of its name inside.

    Raises:
        InvalidRecordingError: it is not there or not readable.
    """
    from clothtrack.recordings.store import read_recording

    if (path / "recording.json").exists():
        return read_recording(path)
    return read_recording(inside(path, tracked.name))


def inside(path: Path, name: str) -> Path:
    """The entry of a folder, or the path itself when it is a file."""
    return path / name if path.is_dir() else path
