"""Verbs as a person runs them: on a pseudo-terminal, with Ctrl-C from its keyboard."""

import json
import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import contextmanager, suppress

import pytest

from clothtrack.cli import command_line as cli

CTRL_C = b"\x03"
VERB = f"{sys.executable} -m clothtrack.cli"
TINY = (
    "size_m=[0.2, 0.2]", "vertex_count=150", "template.vertex_count=200", "sensor.width=160",
    "sensor.height=120", "sensor.focal=150", "action.frame_rate=10",
    "action.distance_m=[0.08, 0.12]", "action.reach_m=0.1",
)  # fmt: skip
PATIENCE_S = 120


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A tiny towel, filmed once: recordings/towel_0001 and its truth."""
    folder = tmp_path_factory.mktemp("world")
    words = ["simulate", str(folder), "--actions", "1", "--seed", "1"]
    assert cli.main([*words, *(word for one in TINY for word in ("--set", one))]) == 0
    return folder


class Terminal:
    """A shell's command on a terminal of 80 columns."""

    def __init__(self, keyboard, process):
        self._keyboard, self._process, self.shown = keyboard, process, ""

    def until(self, pattern):
        """Read until something is shown; what matched."""
        end = time.monotonic() + PATIENCE_S
        while not (found := re.search(pattern, self.shown)):
            assert time.monotonic() < end, self.shown
            if not self._read():
                raise AssertionError(self.shown)
        return found

    def press(self, key):
        os.write(self._keyboard, key)

    def ended(self):
        """Read to the end; the exit code."""
        while self._read():
            pass
        return self._process.wait(PATIENCE_S)

    def _read(self):
        if not select.select([self._keyboard], [], [], PATIENCE_S)[0]:
            return False
        try:
            piece = os.read(self._keyboard, 1 << 16)
        except OSError:  # the last process has closed it
            return False
        self.shown += piece.decode()
        return bool(piece)


@contextmanager
def terminal(command, cwd):
    """Run a command of a shell on a terminal that it owns."""
    keyboard, screen = pty.openpty()
    with subprocess.Popen(
        # Whoever runs the tests in the background may have left Ctrl-C ignored.
        ["env", "--default-signal=INT", "setsid", "--ctty", "--wait", "bash", "-c", command],
        stdin=screen, stdout=screen, stderr=screen, cwd=cwd,
    ) as process:  # fmt: skip
        os.close(screen)
        try:
            yield Terminal(keyboard, process)
        finally:
            with suppress(ProcessLookupError):
                process.kill()
            os.close(keyboard)


@pytest.mark.slow
def test_a_tracking_run_has_one_line_that_is_rewritten(world):
    searched = "--set search.stop_score=0"
    command = f"{VERB} track recordings/towel_0001 --output tracked {searched}"
    with terminal(command, world) as on:
        assert on.ended() == 0
    *states, last = on.shown.replace("\r\n", "\n").split("\r")
    page = last.removeprefix("\x1b[K")
    assert re.fullmatch(r"tracked/towel_0001\.zarr\n  (trust|look|reject): .*\n", page)
    assert not any("\n" in state for state in states)
    told = [
        re.fullmatch(
            r" *(\d+) %.{15}towel_0001: action 1/1, "
            r"candidate (\d+)(?:/7)?, frame (\d+)/(\d+)\x1b\[K",
            state,
        )
        for state in states
    ]
    steps = [[int(number) for number in one.groups()] for one in told if one]
    assert len(steps) > 5
    # The share grows, through one candidate after the other, each from its first frame.
    assert steps == sorted(steps)
    assert {candidate for _, candidate, _, _ in steps} >= {1, 2, 3}


@pytest.mark.slow
def test_a_page_shows_the_mesh_while_it_is_tracked(world):
    command = f"{VERB} track recordings/towel_0001 --output live --live"
    with terminal(command, world) as on:
        address = on.until(r"(http://127\.0\.0\.1:\d+/)   open this to watch\r\n")[1]
        frames, words = set(), ""
        for _ in range(400):
            with suppress(OSError, urllib.error.URLError):
                with urllib.request.urlopen(f"{address}now?after=0", timeout=20) as answer:
                    now = json.load(answer)
                frames.add(now.get("frame"))
                words = now["words"]
                if now["over"]:
                    break
            time.sleep(0.05)
        # The last mesh was sent with the last words; a page asks once more.
        with suppress(OSError), urllib.request.urlopen(f"{address}now?after={now['known']}"):
            pass
        assert on.ended() == 0
    assert len(frames - {None}) > 5
    assert re.match(r"live/towel_0001\.zarr\n  (trust|look|reject): ", words)


@pytest.mark.slow
def test_ctrl_c_is_one_line_and_130_and_ends_a_loop_of_the_shell(world):
    track = f"{VERB} track recordings/towel_0001 --output broken"
    with terminal(f"for i in 1 2 3; do {track}; echo rc $?; done", world) as on:
        on.until("candidate 1/7, frame")
        on.press(CTRL_C)
        assert on.ended() in (130, -2)
    _, _, after = on.shown.partition("^C")
    assert after.count("\n") == 1
    assert "clothtrack: interrupted; what was finished is whole" in after
    assert not list((world / "broken").glob("[!.]*"))
    with terminal(f"trap : INT; {track}; echo rc $?", world) as on:
        on.until("candidate 1/7, frame")
        on.press(CTRL_C)
        on.ended()
    assert "rc 130" in on.shown


@pytest.mark.slow
@pytest.mark.parametrize(
    ("verb", "address"),
    [
        ("view tracked --recordings recordings", r"(http://\S+)   open this; Ctrl-C ends"),
        ("view recordings/towel_0001", r"(http://\S+)   open this; Ctrl-C ends"),
        ("segment recordings/towel_0001", r"(http://\S+)   open this; Ctrl-C ends"),
        (
            "record filmed --replay recordings/towel_0001",
            r"(http://\S+)   open this; Ctrl-C ends",
        ),
    ],
)
def test_a_server_ends_with_ctrl_c_and_0(world, verb, address):
    (world / "tracked").mkdir(exist_ok=True)
    with terminal(f"{VERB} {verb}", world) as on:
        served = on.until(address)[1]
        # An index lists the trajectories as soon as they are read; before that, Ctrl-C may end by
        # the signal (one run in fifteen).
        wanted = b"towel_0001.html" if verb.startswith("view tracked") else b""
        shown, end = None, time.monotonic() + PATIENCE_S
        while shown is None or wanted not in shown:
            assert time.monotonic() < end, shown
            with urllib.request.urlopen(served, timeout=60) as page:
                assert page.status == 200
                shown = page.read()
        on.press(CTRL_C)
        assert on.ended() == 0, on.shown
    assert "Traceback" not in on.shown
    assert "interrupted" not in on.shown
    assert sorted(path.suffix for path in (world / "tracked").glob("[!.]*")) in ([], [".zarr"])


def test_a_file_that_may_not_be_read_is_told_so(world, tmp_path, capsys):
    folder = tmp_path / "towel"
    shutil.copytree(world / "recordings" / "towel_0001", folder)
    (folder / "recording.json").chmod(0)
    is_root = os.geteuid() == 0
    if is_root:  # who may read everything
        os.seteuid(65534)
    try:
        assert cli.main(["inspect", str(folder)]) == 1
        shown = capsys.readouterr().out
    finally:
        if is_root:
            os.seteuid(0)
    assert "no permission to read it; change its owner or its mode" in shown
