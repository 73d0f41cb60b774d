"""How far long work is, for people: one line that is rewritten, or now and then a line.

On a terminal the line is rewritten as the work goes on. A pipe or a log file gets a line every half
minute, later less often, so that the log of a day stays short; work that is done in less leaves no
line there.
"""

import os
import sys
import time
from collections.abc import Callable
from typing import TextIO

_REWRITTEN_S = 0.1
"""Least time between two states of the line on a terminal [s]; a person reads no faster."""

LOGGED_S = 30.0
_LOGGED_SHARE = 0.05
"""Elsewhere a line comes this often [s], or after this share of the time that has passed."""

_USUAL_COLUMNS = 80

_TRUSTED_S = 2.0
"""No time left is said before this much of it has passed [s]: the first steps compile kernels."""


class ProgressLine:
    """The progress of one verb on one stream.

    Attributes:
        text: what was said last.
    """

    def __init__(
        self, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin the work now, with nothing shown.

        Args:
            stream: where to; standard error as it is at that time by default.
            clock: tells the time [s].
        """
        self._given, self._clock = stream, clock
        self._shown = False
        self.text = ""
        self.begin()

    def begin(self) -> None:
        """Begin other work: what is left of it is estimated anew."""
        self._began_s = self._written_s = self._clock()
        self._start: tuple[float, int, int] | None = None
        self._done = 0

    def __call__(self, place: str, done: int, total: int) -> None:
        """Say where the work is (`clothtrack.files.progress`)."""
        now = self._clock()
        # Another count than before is other work: what it takes is not known from the last.
        if self._start is None or done < self._done or (total > 0) != (self._start[2] > 0):
            self._start = now, done, total
        self._done = done
        text = self.text = f"{self._share(now, done, total)}{place}"
        if self._stream.isatty():
            if not self._shown or now - self._written_s >= _REWRITTEN_S or done == total:
                self._stream.write(f"\r{text[: _columns(self._stream) - 1]}\x1b[K")
                self._stream.flush()
                self._written_s, self._shown = now, True
        elif now - self._written_s >= max(LOGGED_S, _LOGGED_SHARE * (now - self._began_s)):
            self._stream.write(text + "\n")
            self._stream.flush()
            self._written_s = now

    def clear(self) -> None:
        """Take the line away, for something else to be written."""
        if self._shown:
            self._stream.write("\r\x1b[K")
            self._shown = False

    @property
    def _stream(self):
        return self._given or sys.stderr

    def _share(self, now: float, done: int, total: int) -> str:
        """Share of the work that is done, and the time that is left, in columns."""
        if total <= 0 or self._start is None:
            return ""
        began_s, before, _ = self._start
        left = ""
        if done > before and now - began_s >= _TRUSTED_S:
            rest_s = (now - began_s) * max(total - done, 0) / (done - before)
            left = f"{duration(rest_s)} left"
        return f"{100 * min(done, total) // total:3d} %  {left:>11}  "


def _columns(stream: TextIO) -> int:
    """Width of a terminal; a longer line would wrap, and could not be rewritten."""
    try:
        return os.get_terminal_size(stream.fileno()).columns or _USUAL_COLUMNS
    except (OSError, ValueError):
        return _USUAL_COLUMNS


def duration(seconds: float) -> str:
    """A time as a person says it, in at most six characters: 40 s, 12 min, 1.5 h, 2.5 d."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    if seconds < 99.5 * 60:
        return f"{seconds / 60:.0f} min"
    if seconds < 48 * 3600:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 86400:.1f} d"
