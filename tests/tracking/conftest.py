"""One small towel, filmed once: what the tests of the whole tracker look at."""

from pathlib import Path

import pytest

from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording


@pytest.fixture(scope="session")
def recording(napkin: Path) -> Recording:
    return read_recording(napkin)
