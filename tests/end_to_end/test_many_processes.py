"""Several command lines in one folder: the work is done once, to the same bits, whoever dies."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from clothtrack import reconstruction
from clothtrack.cli import command_line as cli

FAST = ("--set", "search.method=none")
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
def start():
    """Starts command lines that end with the test."""
    processes = []

    def started(*words, code=""):
        program = ["-c", code] if code else ["-m", "clothtrack.cli"]
        process = subprocess.Popen(
            [sys.executable, *program, *map(str, words)],
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


def seconds(out, verb):
    """Items that some process has finished, and says in how long."""
    paths = sorted((out / ".work" / verb / "items").iterdir())
    return [json.loads(path.read_text())["seconds"] for path in paths]


def no_litter(out):
    assert not [path for path in out.rglob(".*") if path.name != ".work"]
    assert not list(out.glob(".work/*/claims/*"))


@pytest.mark.parametrize(
    ("words", "pattern"),
    [
        (("--trajectories", "4", *SMALL), "[rt]*/**/*"),
        (STATES, "shards/**/*"),
    ],
)
def test_two_that_simulate_at_once_make_what_one_makes(start, tmp_path, words, pattern):
    together, alone = tmp_path / "together", tmp_path / "alone"
    ended_well(*(start("simulate", together, *words) for _ in range(2)))
    assert cli.main(["simulate", str(alone), *words]) == 0
    assert bits(together, pattern) == bits(alone, pattern)
    assert None not in seconds(together, "simulate")
    no_litter(together)
    if words is STATES:
        assert len(json.loads((together / "states.json").read_text())["shards"]) == 3


def test_parts_that_run_at_once_are_the_whole(start, tmp_path):
    out = tmp_path / "out"
    ended_well(
        *(start("simulate", out, "--trajectories", 3, *SMALL, "--shard", f"{k}/2") for k in (1, 2))
    )
    names = sorted(path.name for path in (out / "recordings").iterdir())
    assert names == ["towel_0000", "towel_0001", "towel_0002"]
    assert cli.main(["simulate", str(out), "--shard", "3/2"]) == 1


def test_four_that_track_and_one_that_is_killed(start, towels, tmp_path, capsys):
    """Then labels and measures by two at once; what is said of it; and what a failure says."""
    folders = [tmp_path / "recordings" / f"towel_{letter}" for letter in "abcdef"]
    for folder in folders:
        shutil.copytree(towels / "recordings" / "towel_0002", folder)
    out = tmp_path / "out"
    words = ("track", *folders, "--output", out, *FAST)
    processes = [start(*words) for _ in range(4)]
    claims, end = out / ".work" / "track" / "claims", time.monotonic() + 120
    while not (held := [json.loads(path.read_text() or "{}") for path in claims.glob("[!.]*")]):
        assert time.monotonic() < end
        time.sleep(0.02)
    (killed,) = [one for one in processes if one.pid == held[0]["pid"]]
    killed.kill()
    ended_well(*(one for one in processes if one is not killed))
    assert len(list(out.glob("*.zarr"))) == len(folders)
    assert len({str(bits(path, "positions/**/*")) for path in out.glob("*.zarr")}) == 1
    no_litter(out)

    tracked = sorted(out.glob("*.zarr"))
    labels, measures = tmp_path / "labels", tmp_path / "measures" / "all.json"
    at = ("--recordings", tmp_path / "recordings", "--output")
    ended_well(*(start("evaluate", *tracked[:3], *at, measures) for _ in range(2)))
    assert [one["name"] for one in json.loads(measures.read_text())] == [
        "towel_a", "towel_b", "towel_c",
    ]  # fmt: skip
    again = tmp_path / "again.json"
    assert cli.main(["evaluate", *map(str, (*tracked[:3], *at, again))]) == 0
    assert again.read_bytes() == measures.read_bytes()
    pytest.importorskip("torch")
    ended_well(*(start("label", *tracked[:3], *at, labels) for _ in range(2)))
    assert len(list(labels.glob("*.labels.npz"))) == 3
    assert None not in seconds(labels, "label")

    (folders[0] / "recording.json").write_text("{")
    assert cli.main([*map(str, words)]) == 1
    capsys.readouterr()
    assert cli.main(["status", str(out), "--json"]) == 0
    (shown,) = json.loads(capsys.readouterr().out)
    assert shown["counts"] == {"done": 5, "running": 0, "failed": 1, "not begun": 0}
    assert cli.main(["status", str(out)]) == 0
    said = capsys.readouterr().out
    assert "failed     towel_a   " in said
    assert f"nothing else: clothtrack track {folders[0]}" in said


def test_a_folder_without_work_has_no_status(tmp_path, capsys):
    assert cli.main(["status", str(tmp_path)]) == 1
    assert "nothing was begun here" in capsys.readouterr().err


SMALL_ROBOT = """
import sys
from clothtrack.world import SMALL_WORLD
from clothtrack.world import simulated_episodes as episodes
robot = episodes.SimulatedRobot
small = episodes.SimulatedRobotConfig(episode=SMALL_WORLD)
episodes.SimulatedRobot = lambda kind, seed, _, garment: robot(kind, seed, small, garment)
from clothtrack.cli.command_line import main
if __name__ == "__main__":
    sys.exit(main())
"""


def test_two_that_flatten_at_once_flatten_what_one_flattens(start, tmp_path):
    words = ("--policy", "heuristic", "--actions", "1", "--episodes", "2")
    together, alone = tmp_path / "together", tmp_path / "alone"
    ended_well(*(start("flatten", together, *words, code=SMALL_ROBOT) for _ in range(2)))
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
    assert None not in seconds(together, "flatten")
    no_litter(together)


HOLD = """
import sys, time
from pathlib import Path
from clothtrack.files.work_folder import WorkFolder
with WorkFolder(Path(sys.argv[1]), sys.argv[2]).alone():
    (Path(sys.argv[1]) / "held").touch()
    time.sleep(600.0)
"""


def files_of(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("verb", ["train-dynamics", "improve"])
def test_what_cannot_be_shared_is_refused_in_one_line(start, tmp_path, capsys, verb):
    out = tmp_path / "out"
    words = [verb, str(out), "--only-roll-outs", "--roll-outs", "1", "--garment", "towel"]
    words += ["--set", "roll_outs.vertex_count=120", "--set", "roll_outs.starts=1"]
    words += ["--set", "roll_outs.actions=1", "--set", "roll_outs.states.crumpling.states=1"]
    if verb == "improve":
        pytest.importorskip("torch")
        weights = Path(reconstruction.__file__).parent / "weights" / "towel.safetensors"
        words = [verb, str(weights), "--output", str(out)]
    first = start(out, verb, code=HOLD)
    while not (out / "held").exists():
        assert first.poll() is None, first.communicate()
        time.sleep(0.02)
    before = files_of(out)
    assert cli.main(words) == 1
    complained = capsys.readouterr().err
    assert f"{verb} is at work here already" in complained
    assert f"process {first.pid}, since 2" in complained
    assert complained.count("\n") == 1
    assert files_of(out) == before
    first.kill()
    first.communicate()
    if verb == "train-dynamics":
        assert cli.main(words) == 0
        assert len(list(out.glob("roll_outs/towel/shards/*.npz"))) == 1
        no_litter(out)
