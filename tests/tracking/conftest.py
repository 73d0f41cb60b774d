"""One small towel, filmed once: what the tests of the whole tracker look at."""

import pytest

from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording
from clothtrack_lab.world.episodes import SMALL_WORLD
from clothtrack_lab.world.filming import simulate


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("world")
    simulate(folder, "towel", 1, config=SMALL_WORLD)
    return read_recording(next((folder / "recordings").glob("towel*")))
