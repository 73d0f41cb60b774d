"""Several workers, and a run that is killed: the same bits as one process that nobody disturbs."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from clothtrack.cli import command_line as cli

pytestmark = pytest.mark.slow

FAST = ("--set", "search.method=none", "--set", "cloth.substep_s=3.3e-3")
TINY = (
    "size_m=[0.2, 0.2]",
    "vertex_count=120",
    "template.vertex_count=100",
    "sensor.width=80",
    "sensor.height=60",
    "sensor.focal=75",
    "actions=1",
)
SMALL = tuple(word for setting in TINY for word in ("--set", setting))
STATES = (
    "--states", "12", "--set", "vertex_count=120", "--set", "episodes=2",
    "--set", "crumpling.states=2", "--set", "crumpling.rest_limit_s=0.2",
)  # fmt: skip


@pytest.fixture
def start(tmp_path):
    """Starts command lines that end with the test."""
    processes = []

    def started(*words, code=""):
        program = ["-m", "clothtrack.cli"]
        if code:
            # A file, which workers read as well.
            (tmp_path / "program.py").write_text(code)
            program = [tmp_path / "program.py"]
        process = subprocess.Popen(
            [sys.executable, *map(str, (*program, *words))],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        processes.append(process)
        return process

    yield started
    for process in processes:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def ended_well(*processes):
    for process in processes:
        _, complained = process.communicate(timeout=300)
        assert process.returncode == 0, complained


def bits(folder, pattern):
    """Digests of files, but those that hold CPU times, by their names."""
    files = [path for path in folder.glob(pattern) if path.is_file() and path.name != "zarr.json"]
    assert files
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def no_litter(out):
    assert not list(out.rglob(".*"))


@pytest.mark.parametrize(
    ("words", "pattern"),
    [
        (("--trajectories", "3", *SMALL), "[rt]*/**/*"),
        (STATES, "shards/**/*"),
    ],
)
def test_two_workers_make_what_one_makes(start, tmp_path, words, pattern):
    together, alone = tmp_path / "together", tmp_path / "alone"
    ended_well(start("simulate", together, *words, "--workers", 2))
    assert cli.main(["simulate", str(alone), *words]) == 0
    assert bits(together, pattern) == bits(alone, pattern)
    no_litter(together)
    if words is STATES:
        assert len(json.loads((together / "states.json").read_text())["shards"]) == 3


def test_a_killed_run_goes_on_to_the_bits_of_one_that_was_not(start, towels, tmp_path, capsys):
    """Then labels and measures by two workers; they are kept; and what a bad recording does."""
    folders = [tmp_path / "recordings" / f"towel_{letter}" for letter in "abcd"]
    for folder in folders:
        shutil.copytree(towels / "recordings" / "towel_0002", folder)
    out, alone = tmp_path / "out", tmp_path / "alone"
    words = ("track", *folders, *FAST, "--output")
    killed = start(*words, out, "--workers", 2)
    end = time.monotonic() + 240
    while not list(out.glob("*.zarr")):
        assert killed.poll() is None, killed.communicate()
        assert time.monotonic() < end
        time.sleep(0.02)
    killed.kill()
    killed.communicate()
    finished = {path: path.stat().st_mtime_ns for path in out.glob("*.zarr/zarr.json")}
    assert 1 <= len(finished) < len(folders)
    ended_well(start(*words, out, "--workers", 2))
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    assert cli.main([*map(str, words), str(alone)]) == 0
    tracked = sorted(out.glob("*.zarr"))
    assert [path.stem for path in tracked] == [folder.name for folder in folders]
    for path in tracked:
        assert bits(path, "positions/**/*") == bits(alone / path.name, "positions/**/*")
    no_litter(out)

    labels, measures = tmp_path / "labels", tmp_path / "measures" / "all.json"
    at = ("--recordings", tmp_path / "recordings", "--output")
    ended_well(start("evaluate", *tracked, *at, measures, "--workers", 2))
    assert [one["name"] for one in json.loads(measures.read_text())] == [
        folder.name for folder in folders
    ]
    again = tmp_path / "again.json"
    assert cli.main(["evaluate", *map(str, (*tracked, *at, again))]) == 0
    assert again.read_bytes() == measures.read_bytes()
    pytest.importorskip("torch")
    ended_well(start("label", *tracked, *at, labels, "--workers", 2))
    written = files_of(labels)
    assert len(written) == 4
    assert cli.main(["label", *map(str, (*tracked, *at, labels))]) == 0
    assert files_of(labels) == written
    assert cli.main(["label", *map(str, (*tracked[:1], *at, labels)), "--garment", "towel"]) == 0
    changed = {path for path, when in files_of(labels).items() if written[path] != when}
    assert changed == {labels / "towel_a.labels.npz"}

    (folders[0] / "recording.json").write_text("{")
    capsys.readouterr()
    assert cli.main([*map(str, words), str(out), "--workers", "2"]) == 1
    said = capsys.readouterr()
    assert said.out.count("(finished before)") == 3
    assert str(folders[0]) in said.err


SMALL_ROBOT = """
import sys
from clothtrack_lab.world import SMALL_WORLD
from clothtrack_lab.world import simulated_episodes as episodes
robot = episodes.SimulatedRobot
small = episodes.SimulatedRobotConfig(episode=SMALL_WORLD)
episodes.SimulatedRobot = lambda kind, seed, _, garment: robot(kind, seed, small, garment)
from clothtrack.cli.command_line import main
if __name__ == "__main__":
    sys.exit(main())
"""


def files_of(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


def test_two_workers_flatten_what_one_flattens(start, tmp_path):
    words = ("--policy", "heuristic", "--actions", "1", "--episodes", "2")
    together, alone = tmp_path / "together", tmp_path / "alone"
    ended_well(start("flatten", together, *words, "--workers", 2, code=SMALL_ROBOT))
    ended_well(start("flatten", alone, *words, code=SMALL_ROBOT))
    for pattern in ("recordings/**/*", "truth/*", "worlds/**/*", "starts/**/*"):
        assert bits(together, pattern) == bits(alone, pattern)
    for folder in sorted((alone / "episodes").iterdir()):
        first, second = (
            [row["true_m2"] for row in json.loads((out / "episode.json").read_text())["steps"]]
            for out in (folder, together / "episodes" / folder.name)
        )
        assert len(first) == 2
        assert first == second
    assert len(list(together.glob("*.html"))) == 2
    no_litter(together)
