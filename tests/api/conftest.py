"""One small run for all tests of the front: a napkin folded once in the simulated world."""

import pytest

import clothtrack as ct
import clothtrack_lab as lab


@pytest.fixture(scope="session")
def world(tmp_path_factory):
    """Folder with recordings/ and truth/ of one napkin."""
    folder = tmp_path_factory.mktemp("world")
    lab.simulate(folder, "towel", 1, seed=3, small=True)
    return folder


@pytest.fixture(scope="session")
def recording(world):
    return ct.read_recording(world / "recordings" / "towel_0003")


@pytest.fixture(scope="session")
def run(recording):
    """Tracked by the dynamics alone, which is quick."""
    return ct.track(recording, mode="open_loop", settings=("seed=7",))
