"""The progress of long work, shown to people.

On a terminal, one line is rewritten as the work proceeds. A pipe or a log file gets a line every
half minute, later less often, so that the log of a day stays short. Shorter work leaves no line
there.
"""

import os
import sys
import time
from collections.abc import Callable
from typing import TextIO

_REWRITTEN_S = 0.1
"""Shortest time between two updates on a terminal [s]; a person reads no faster."""

LOGGED_S = 30.0
_LOGGED_SHARE = 0.05
"""Elsewhere, the time between lines: this [s], or this share of the elapsed time if larger."""

_USUAL_COLUMNS = 80

_TRUSTED_S = 2.0
"""The remaining time is not shown before this [s], because the first steps compile kernels."""


class ProgressLine:
    """The progress of one verb on one stream."""

    def __init__(
        self, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin the work now, with nothing shown.

        Args:
            clock: returns the time [s].
        """
        self._given, self._clock = stream, clock
        self._shown = False
        self.text = ""
        self.begin()

    def begin(self) -> None:
        """Begin new work and restart the estimate of the remaining time."""
        self._began_s = self._written_s = self._clock()
        self._start: tuple[float, int, int] | None = None
        self._done = 0

    def __call__(self, place: str, done: int, total: int) -> None:
        """Show the progress (`clothtrack.files.progress`)."""
        now = self._clock()
        # A count that falls, or a total that appears or vanishes, marks new work of unknown speed.
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
        """Erase the line so that something else can be written."""
        if self._shown:
            self._stream.write("\r\x1b[K")
            self._shown = False

    @property
    def _stream(self):
        return self._given or sys.stderr

    def _share(self, now: float, done: int, total: int) -> str:
        """Return the share of the work done and the remaining time, in columns."""
        if total <= 0 or self._start is None:
            return ""
        began_s, before, _ = self._start
        left = ""
        if done > before and now - began_s >= _TRUSTED_S:
            rest_s = (now - began_s) * max(total - done, 0) / (done - before)
            left = f"{duration(rest_s)} left"
        return f"{100 * min(done, total) // total:3d} %  {left:>11}  "


def _columns(stream: TextIO) -> int:
    """Return the width of a terminal; a longer line would wrap and could not be rewritten."""
    try:
        return os.get_terminal_size(stream.fileno()).columns or _USUAL_COLUMNS
    except (OSError, ValueError):
        return _USUAL_COLUMNS


def duration(seconds: float) -> str:
    """Return a duration in at most six characters: 40 s, 12 min, 1.5 h, 2.5 d."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    if seconds < 99.5 * 60:
        return f"{seconds / 60:.0f} min"
    if seconds < 48 * 3600:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 86400:.1f} d"
