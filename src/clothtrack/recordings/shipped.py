"""The recordings that are shipped with clothtrack."""

from pathlib import Path

from clothtrack.errors import InvalidRecordingError

SHIPPED = Path(__file__).parents[1] / "shipped"


def shipped_recording(name: str = "") -> Path:
    """Return the folder of the shipped recording of this name; of the first one without a name.

    Raises:
        InvalidRecordingError: there is none; the message names those that there are.
    """
    folders = {path.parent.name: path.parent for path in sorted(SHIPPED.glob("*/recording.json"))}
    if not folders:
        raise InvalidRecordingError(
            f"{SHIPPED}: no recording comes with this installation; install clothtrack again"
        )
    if name and name not in folders:
        raise InvalidRecordingError(
            f"no shipped recording is called {name!r}; there are {', '.join(folders)}"
        )
    return folders[name] if name else next(iter(folders.values()))
