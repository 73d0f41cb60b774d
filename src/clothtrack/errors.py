"""Errors that a user can act on.

A message names the file, the field, the value found, what is allowed and what to do next.
Expected failures of the method (a line search that gives up, an alignment that stops early) are
recorded results, not exceptions.
"""

import errno
from pathlib import Path
from typing import Any


class ClothTrackError(Exception):
    """The base of all errors that clothtrack raises on purpose; the command line exits with 1."""


class InvalidRecordingError(ClothTrackError):
    """A recording on disk cannot be used as it is.

    Attributes:
        violation: what a finished recording violates, if that is the reason.
    """

    def __init__(self, message: str, violation: Any = None) -> None:
        """Keep the violation beside the message."""
        super().__init__(message)
        self.violation = violation


class TruncatedError(ClothTrackError):
    """A part of a source is missing or damaged; the rest may be intact, so the import continues."""


class InvalidMeshError(ClothTrackError):
    """A mesh cannot be a cloth: not finite, not manifold, degenerate or of the wrong size."""


class SimulationDivergedError(ClothTrackError):
    """The cloth simulation became non-finite and there is no earlier state to return to."""


class InvalidResultError(ClothTrackError):
    """A tracked trajectory on disk is missing, unfinished or from another version."""


class InvalidConfigError(ClothTrackError):
    """Settings that contradict each other or the data they are used with."""


class WrongUsageError(InvalidConfigError):
    """A request that cannot be understood or contradicts itself; the exit code is 2."""


class StorageError(ClothTrackError):
    """The file system refused an operation: it is full, read-only or denies access."""

    @classmethod
    def of(cls, error: OSError, path: Path | None = None) -> "StorageError":
        """Return the error with a remedy and the path: `path`, or else that of `error`."""
        where = path or error.filename or "the output"
        text = _REMEDIES.get(error.errno or 0, error.strerror or str(error))
        return cls(f"{where}: {text}")


def why_unreadable(error: OSError, remedy: str) -> str:
    """Return why a file cannot be opened and what to do, as "problem; remedy"."""
    if isinstance(error, PermissionError):
        return "no permission to read it; change its owner or its mode"
    missing = isinstance(error, FileNotFoundError)
    return f"{'the file is missing' if missing else error.strerror}; {remedy}"


_REMEDIES = {
    errno.ENOSPC: "the disk is full; free some space and run the same command again",
    errno.EFBIG: "a file would grow beyond the system's limit; raise it (ulimit -f), or free some "
    "space, and run the same command again",
    errno.EDQUOT: "the quota is used up; free some space and run the same command again",
    errno.EACCES: "no permission; choose another folder or change its owner",
    errno.EROFS: "the disk is read-only; choose another folder",
    errno.EEXIST: "something of this name is in the way; choose another name or remove it",
    errno.ENOTEMPTY: "something of this name is in the way; choose another name or remove it",
    errno.ENOTDIR: "a file is where a folder belongs; choose another name or remove it",
    errno.ENOENT: "there is no such file or folder; check the name",
}
