"""A recording given to a verb that changes it: a folder, or one in memory."""

import logging
from dataclasses import replace
from pathlib import Path

from clothtrack.api.results import Result
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording

logger = logging.getLogger(__name__)


def opened_recording(given: Recording | Path | str) -> Recording:
    """Return the recording of a folder, or the given one as one that nothing is written to."""
    if isinstance(given, Recording):
        return replace(given, folder=Path(given.name))
    return read_recording(given)


def place_of(given: Recording | Path | str) -> Path:
    """Return the folder as it was given, or the name of a recording in memory, for a report."""
    return Path(given.name if isinstance(given, Recording) else given)


def reported(
    given: Recording | Path | str, changed: Recording, result: Result
) -> Recording | Result:
    """Return the changed recording if one was given, and the result of a folder."""
    if not isinstance(given, Recording):
        return result
    logger.info("%s", result.words)
    for doubt in result.doubts:
        logger.warning("%s", doubt)
    return changed
