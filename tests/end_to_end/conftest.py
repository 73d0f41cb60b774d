"""A tiny towel, filmed through the command line, once for all tests of this folder."""

import subprocess
import sys
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


@pytest.fixture
def clothtrack():
    """Runs the command line in a process of its own."""

    def run(*words: object, before: str = "") -> subprocess.CompletedProcess[str]:
        code = (
            f"import sys\n{before}\nfrom clothtrack.cli.command_line import main\nsys.exit(main())"
        )
        return subprocess.run(
            [sys.executable, "-c", code, *map(str, words)],
            capture_output=True, text=True, check=False, timeout=300,
        )  # fmt: skip

    return run
