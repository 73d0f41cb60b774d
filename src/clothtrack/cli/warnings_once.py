"""Logging to standard error that prints each kind of warning only once."""

import logging
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from clothtrack.cli.terminal import progress

_COUNTED = re.compile(r"(?<!\w)\d+")
"""Numbers of frames, files and places; digits inside a name are part of it."""


class _WarningsOnce(logging.Handler):
    """A handler that writes the first warning of each kind, and at the end how many followed."""

    def __init__(self) -> None:
        """Begin with no warning written."""
        super().__init__()
        self.setFormatter(logging.Formatter("%(levelname)s %(message)s"))
        self._told: dict[str, dict[str, None]] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record, unless a warning of the same kind was written before."""
        line = self.format(record)
        if record.levelno >= logging.WARNING:
            same = self._told.setdefault(_COUNTED.sub("#", line), {})
            known = bool(same)
            same[line] = None
            if known:
                return
        self._write(line)

    def close(self) -> None:
        """Write how many warnings were left out, counting identical ones once."""
        told, self._told = self._told, {}
        for same in told.values():
            if (others := len(same) - 1) > 0:
                self._write(f"{others} more like this: {next(iter(same))}")
        super().close()

    @staticmethod
    def _write(line: str) -> None:
        progress.clear()
        sys.stderr.write(line + "\n")


@contextmanager
def logged(*, verbose: bool) -> Iterator[None]:
    """Send log records to standard error during the block."""
    root, handler = logging.getLogger(), _WarningsOnce()
    level = root.level
    root.setLevel(logging.INFO if verbose else logging.WARNING)
    root.addHandler(handler)
    try:
        yield
    finally:
        root.removeHandler(handler)
        root.setLevel(level)
        handler.close()
