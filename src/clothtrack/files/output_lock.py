"""The lock that allows one run at a time in an output folder."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, SoftFileLock, Timeout

from clothtrack.errors import InvalidConfigError
from clothtrack.files.atomic_write import storage

LOCK_FILE = ".clothtrack.lock"


@contextmanager
def locked_output(folder: Path) -> Iterator[None]:
    """Hold the lock of an output folder during the block.

    The operating system releases the lock of a process that dies.
    """
    folder = Path(folder)
    path = folder / LOCK_FILE
    with storage(folder):
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path)
        try:
            lock.acquire(timeout=0)
        except Timeout as error:
            raise InvalidConfigError(
                f"{folder}: another run writes here{_holder(path)}; wait until it ends, or choose "
                "another folder"
            ) from error
    try:
        if not isinstance(lock, SoftFileLock):
            with suppress(OSError):
                path.write_text(f"{os.getpid()}\n{socket.gethostname()}\n", encoding="utf-8")
        yield
    finally:
        # Remove it while it is held: FileLock retries if it has locked a file without a name.
        path.unlink(missing_ok=True)
        lock.release()


def _holder(path: Path) -> str:
    """Return in words who holds a lock; empty if the file does not say."""
    with suppress(OSError, ValueError):
        pid, host = path.read_text(encoding="utf-8").split("\n")[:2]
        if pid.isdigit():
            return f" (process {pid} on {host})"
    return ""
