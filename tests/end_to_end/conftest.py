"""A tiny towel, filmed through the command line, once for all tests of this folder."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from clothtrack.cli import command_line as cli

TINY = (
    "size_m=[0.2, 0.2]",
    "vertex_count=150",
    "template.vertex_count=200",
    "sensor.width=160",
    "sensor.height=120",
    "sensor.focal=150",
    "action.frame_rate=10",
    "action.distance_m=[0.08, 0.12]",
    "action.reach_m=0.1",
    # The robot is wrong by this much about where its tip is: what it commands is not enough.
    "picker_bias_m=0.006",
)


@pytest.fixture(scope="session")
def towels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`recordings/towel_0001`, `towel_0002` and their `truth/`, one pick-and-place each."""
    world = tmp_path_factory.mktemp("world")
    settings = [word for setting in TINY for word in ("--set", setting)]
    words = ["simulate", str(world), "--trajectories", "2", "--actions", "1", "--seed", "1"]
    assert cli.main([*words, *settings]) == 0
    return world


# As the process that a terminal starts, whatever the shell above the tests has set.
MAIN = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from clothtrack.cli.command_line import main
if __name__ == "__main__":
    sys.exit(main())
"""


@pytest.fixture
def start(tmp_path):
    """Start the command line in a session of its own; nothing of it is left after the test."""
    processes = []

    def started(*words: object, before: str = "") -> subprocess.Popen[str]:
        # A file, which workers read as well.
        (tmp_path / "program.py").write_text(before + MAIN)
        process = subprocess.Popen(
            [sys.executable, *map(str, (tmp_path / "program.py", *words))],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        processes.append(process)
        return process

    yield started
    for process in processes:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


@pytest.fixture
def wait_until():
    """Wait until something is true while a process runs."""

    def wait(is_true: Callable[[], object], process: subprocess.Popen[str]) -> None:
        end = time.monotonic() + 240
        while not is_true():
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < end
            time.sleep(0.005)

    return wait
