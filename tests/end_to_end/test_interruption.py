"""Ctrl-C, SIGTERM and a full disk: what was finished is whole, nothing else keeps its name."""

import os
import re
import shutil
import signal

import pytest

from clothtrack.cli import command_line as cli
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

# What is tracked does not matter here: long substeps and few iterations.
FAST = (
    "--set", "search.method=none", "--set", "cloth.substep_s=3.3e-3",
    "--set", "objective.iterations=20",
)  # fmt: skip


@pytest.fixture
def many(towels, tmp_path):
    """The same towel under six names: the first is done long before the last."""
    folders = [tmp_path / "recordings" / f"towel_{letter}" for letter in "abcdef"]
    for folder in folders:
        shutil.copytree(towels / "recordings" / "towel_0002", folder)
    return folders


def complaints(written):
    """Lines on standard error but those of progress, which come where a machine is slow."""
    lines = written.splitlines()
    return [line for line in lines if not re.match(r" *\d+ %  |.*: first mesh$", line)]


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_in_the_middle(start, wait_until, many, tmp_path, workers):
    out = tmp_path / "out"
    first = out / "towel_a.zarr"
    process = start("track", *many, "--output", out, *FAST, "--workers", workers)
    wait_until(first.exists, process)
    # A terminal sends it to the whole group, workers included.
    os.killpg(process.pid, signal.SIGINT)
    told, complained = process.communicate(timeout=60)
    # Shells tell this as 130, and end their loops.
    assert process.returncode == -signal.SIGINT, complained
    assert told == ""
    lines = complaints(complained)
    assert len(lines) == 1, complained
    assert "interrupted" in lines[0]
    assert "same command" in lines[0]

    finished = sorted(out.glob("*.zarr"))
    assert first in finished
    assert len(finished) < len(many)
    for path in finished:
        assert len(TrackedTrajectory.load(path).actions) == 1


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_no_worker_outlives_a_run_that_is_ended(start, wait_until, many, tmp_path, number):
    out = tmp_path / "out"
    process = start("track", *many, "--output", out, *FAST, "--workers", 2)
    wait_until((out / "towel_a.zarr").exists, process)
    # Schedulers and containers tell one process, and the workers are not that one.
    process.send_signal(number)
    # The pipes end when the last process that holds them does.
    told, complained = process.communicate(timeout=20)
    assert process.returncode == (143 if number == signal.SIGTERM else -number), complained
    assert told == ""
    if number == signal.SIGTERM:
        assert len(complaints(complained)) == 1, complained
        assert "interrupted" in complained
        assert not list(out.glob(".*")), "what is half-written, or the lock"
    for path in out.glob("*.zarr"):
        assert len(TrackedTrajectory.load(path).actions) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, -signal.SIGINT), (signal.SIGTERM, 143)]
)
def test_filming_in_workers_ends_without_a_trace(start, wait_until, tmp_path, number, code):
    out = tmp_path / "out"
    process = start("simulate", out, "--trajectories", 4, "--workers", 2)
    wait_until(lambda: len(list(out.glob("recordings/.*"))) >= 2, process)
    os.killpg(process.pid, number)
    told, complained = process.communicate(timeout=30)
    assert process.returncode == code, complained
    assert told == ""
    assert len(complaints(complained)) == 1, complained
    assert list((out / "recordings").iterdir()) == []


def test_the_same_command_goes_on_from_there(many, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["track", str(many[0]), "--output", str(out), *FAST]) == 0
    written = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    # What a killed process leaves behind does not pass for a result.
    (out / ".towel_b.zarr.killed").mkdir()
    (out / ".towel_b.zarr.killed" / "zarr.json").write_text("{")
    capsys.readouterr()
    folders = [str(folder) for folder in many[:2]]
    assert cli.main(["track", *folders, "--output", str(out), *FAST]) == 0
    said = capsys.readouterr().out.splitlines()
    first, second = [line for line in said if not line.startswith("  ")]
    assert first == f"{out / 'towel_a.zarr'}   (finished before)"
    assert second == f"{out / 'towel_b.zarr'}"
    assert {path: path.stat().st_mtime_ns for path in written} == written


@pytest.mark.slow
def test_a_full_disk(start, many, tmp_path):
    """No file may grow beyond a kilobyte: the system refuses the write as a full disk does."""
    out = tmp_path / "out"
    assert cli.main(["track", str(many[0]), "--output", str(out), *FAST]) == 0
    full = (
        "import resource, clothtrack.tracking.tracked_trajectory as stored\n"
        "write = stored._write\n"
        "def on_a_full_disk(*arguments):\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))\n"
        "    write(*arguments)\n"
        "stored._write = on_a_full_disk\n"
    )
    process = start("track", many[0], many[1], "--output", out, *FAST, before=full)
    told, complained = process.communicate(timeout=300)
    assert process.returncode == 1, complained
    assert "finished before" in told
    lines = complaints(complained)
    assert len(lines) == 1, complained
    for word in ("towel_b.zarr", "some space", "run the same command again"):
        assert word in lines[0]
    assert sorted(path.name for path in out.iterdir()) == ["towel_a.zarr"]
    TrackedTrajectory.load(out / "towel_a.zarr")


def test_a_file_where_the_output_folder_belongs(many, tmp_path, capsys):
    (tmp_path / "out").write_text("mine")
    for output in (tmp_path / "out", tmp_path / "out" / "below"):
        assert cli.main(["track", str(many[0]), "--output", str(output), *FAST]) == 1
        told = capsys.readouterr().err
        assert str(output) in told
        assert "choose another name" in told
        assert told.count("\n") == 1
    assert (tmp_path / "out").read_text() == "mine"
