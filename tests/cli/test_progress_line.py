"""Progress is one line that a terminal rewrites, and now and then a line elsewhere."""

import os
import pty
import select

import pytest

from clothtrack.cli.progress_line import LOGGED_S, ProgressLine, duration
from clothtrack.files.progress import one_of


class Clock:
    """Says the time that it was set to."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def terminal():
    """The writing end of a terminal, and what reads all that it shows."""
    shown, keyboard = pty.openpty()
    with os.fdopen(keyboard, "w") as stream:
        yield stream, lambda: all_of(shown).decode()
    os.close(shown)


def all_of(terminal):
    """What a terminal shows; it may come in pieces."""
    told = b""
    while select.select([terminal], [], [], 0.3)[0]:
        told += os.read(terminal, 1 << 16)
    return told


@pytest.fixture
def log(tmp_path):
    """A log file, and what reads all that is in it."""
    with (tmp_path / "log").open("w") as stream:
        yield stream, (tmp_path / "log").read_text


def test_a_terminal_has_one_line_that_is_rewritten(clock, terminal):
    stream, shown = terminal
    line = ProgressLine(stream, clock)
    for done in range(11):
        clock.now = float(done)
        line(f"frame {done}/40", done, 40)
    line.clear()
    told = shown()
    assert "\n" not in told
    states = told.split("\r")[1:]
    assert len(states) == 12
    assert states[0] == "  0 %               frame 0/40\x1b[K"
    # A frame a second: the other thirty take half a minute.
    assert states[10] == " 25 %    30 s left  frame 10/40\x1b[K"
    assert states[11] == "\x1b[K"


def test_a_pipe_has_sparse_lines_that_get_rarer(clock, log):
    stream, written = log
    line = ProgressLine(stream, clock)
    day_s = 24 * 3600
    for done in range(day_s):
        clock.now = float(done)
        line("step", done, day_s)
    line.clear()
    lines = written().splitlines()
    assert 50 < len(lines) < 200
    assert lines[0].endswith("24.0 h left  step")
    assert not set("\r\x1b") & set(written())


def test_short_work_leaves_nothing_in_a_pipe(clock, log):
    stream, written = log
    line = ProgressLine(stream, clock)
    for done in range(100):
        clock.now = 0.99 * LOGGED_S * done / 100
        line("step", done, 100)
    line.clear()
    assert not written()


def test_a_thing_among_several_is_told_as_a_part_of_all():
    told = []
    third = one_of(lambda *words: told.append(words), 2, 4, "episode")
    third("action 1/10", 5, 10)
    place, done, total = told[0]
    assert place == "episode 3/4, action 1/10"
    assert done / total == 2.5 / 4
    assert one_of(third, 0, 1) is third
    assert one_of(None, 2, 4) is None


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.2, "0 s"), (99, "99 s"), (100, "2 min"), (5900, "98 min"), (6000, "1.7 h"), (2e5, "2.3 d")],
)
def test_times_are_said_as_people_do(seconds, said):
    assert duration(float(seconds)) == said
