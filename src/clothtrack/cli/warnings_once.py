"""What the stages log, on standard error: a warning once for each cause, however often it comes."""

import logging
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from clothtrack.cli.terminal import progress

_COUNTED = re.compile(r"(?<!\w)\d+")
"""Numbers of frames, files and places; those in a name belong to it."""


class _WarningsOnce(logging.Handler):
    """Writes the first warning of each cause, and at the end how many more there were."""

    def __init__(self) -> None:
        """Begin with no warning told."""
        super().__init__()
        self.setFormatter(logging.Formatter("%(levelname)s %(message)s"))
        self._told: dict[str, dict[str, None]] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record, unless one of its cause was written before."""
        line = self.format(record)
        if record.levelno >= logging.WARNING:
            same = self._told.setdefault(_COUNTED.sub("#", line), {})
            known = bool(same)
            same[line] = None
            if known:
                return
        self._write(line)

    def close(self) -> None:
        """Say how many warnings were left out; those that are word for word the same are one."""
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
    """While the block runs, what is logged goes to standard error.

    Args:
        verbose: not only warnings, but what happens, too.
    """
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
