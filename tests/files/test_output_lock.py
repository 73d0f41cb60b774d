"""One run at a time in an output folder."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress

import pytest

from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidConfigError, StorageError
from clothtrack.files.output_lock import LOCK_FILE, locked_output

HOLD = """
import sys, time
from pathlib import Path
from clothtrack.files.output_lock import locked_output
with locked_output(Path(sys.argv[1])):
    (Path(sys.argv[1]) / "held").touch()
    time.sleep(600.0)
"""


@contextmanager
def holding(out):
    """Another process that holds the lock of a folder."""
    with subprocess.Popen([sys.executable, "-c", HOLD, str(out)], start_new_session=True) as held:
        try:
            while not (out / "held").exists():
                assert held.poll() is None
                time.sleep(0.02)
            yield held
        finally:
            with suppress(ProcessLookupError):
                os.killpg(held.pid, signal.SIGKILL)


@pytest.fixture
def other(tmp_path):
    """Another process that holds the lock of `tmp_path / "out"`."""
    with holding(tmp_path / "out") as process:
        yield process


def test_another_process_is_refused_until_the_first_one_dies(other, tmp_path):
    out = tmp_path / "out"
    before = (out / LOCK_FILE).read_text()
    with pytest.raises(InvalidConfigError) as refused, locked_output(out):
        pass
    assert f"{out}: another run writes here (process {other.pid} on " in str(refused.value)
    assert (out / LOCK_FILE).read_text() == before
    other.kill()
    other.wait()
    with locked_output(out):
        assert (out / LOCK_FILE).read_text().split("\n")[0] == str(os.getpid())
    assert [path.name for path in out.iterdir()] == ["held"]


def test_a_place_that_cannot_be_locked_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="in the way"), locked_output(tmp_path / "file"):
        pass


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """A folder that another process has locked, and that process."""
    out = tmp_path_factory.mktemp("held") / "out"
    with holding(out) as process:
        yield out, process


@pytest.mark.parametrize("verb", ["simulate", "bench", "track", "evaluate", "flatten"])
def test_a_second_run_is_refused_in_one_line_and_changes_nothing(held, verb, tmp_path, capsys):
    out, other = held
    if verb == "evaluate":
        # Its output is a file, beside which the locked folder is.
        out = out.rename(out.with_name(f".{out.name}.measured"))
    words = {
        "simulate": ["simulate", str(out)],
        "bench": ["simulate", str(out), "--benchmark", "all"],
        "track": ["track", str(tmp_path / "none"), "--output", str(out)],
        "flatten": ["flatten", str(out), "--policy", "heuristic"],
    }.get(verb)
    if words is None:
        words = ["evaluate", str(tmp_path / "a.zarr"), "--recordings", str(tmp_path)]
        words += ["--output", str(held[0])]
    try:
        assert cli.main(words) == 1
        complained = capsys.readouterr().err
        assert f"{out}: another run writes here (process {other.pid} on " in complained
        assert complained.count("\n") == 1
        assert {path.name for path in out.iterdir()} == {"held", LOCK_FILE}
    finally:
        out.rename(held[0])
