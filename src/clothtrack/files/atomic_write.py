"""Files and folders that appear whole under their final name, or not at all."""

import errno
import hashlib
import os
import re
import shutil
import signal
import threading
import time
import unicodedata
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from clothtrack.errors import StorageError

_LATE_WRITERS_S = 2.0
"""Longest time [s] that late writers may still write into a folder that is being removed."""

_OLD = ".old"
"""Suffix of the hidden name of a folder that is being replaced."""

_UNFINISHED = re.compile(r"\.(.*)\.[0-9a-f]{8}\.unfinished(.*)")

_LONGEST_NAME = 200
"""Longest name [characters]; file systems allow 255, including the suffixes that are added."""


def name_problem(name: object) -> str:
    """Return why a name cannot name one entry of a folder; empty when it can.

    Call it before a name becomes part of a path: `../x` leads out of the folder.
    """
    if not isinstance(name, str):
        return "it is no text"
    if not name or name in (".", ".."):
        return "it is empty" if not name else "it names a folder itself"
    if "/" in name or "\\" in name:
        return "it has a separator of folders"
    if any(unicodedata.category(letter) in ("Cc", "Cs") for letter in name):
        return "it has a control character"
    if len(name) > _LONGEST_NAME:
        return f"it has {len(name)} characters, more than {_LONGEST_NAME}"
    return ""


@contextmanager
def storage(path: Path) -> Iterator[None]:
    """Turn an `OSError` of the block into a `StorageError` that names the file and a remedy."""
    try:
        yield
    except OSError as error:
        raise StorageError.of(error, path) from error


def content_hash(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal digits."""
    with storage(path), Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a temporary file to write to; it is renamed to `path` on success.

    The temporary name keeps the suffix, from which writers guess the format.
    """
    path = Path(path)
    temporary: Path | None = None
    with storage(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary = path.with_name(hidden_name(path.stem, path.suffix))
            temporary.touch(exist_ok=False)
            yield temporary
            # Some writers recreate the file with permissions for its owner only.
            temporary.chmod(0o644)
            _flush(temporary)
            os.replace(temporary, path)
        finally:
            if temporary is not None:
                temporary.unlink(missing_ok=True)


def write_file(path: Path, data: bytes | memoryview) -> None:
    """Write a file, whole or not at all."""
    with atomic_file(path) as unfinished:
        unfinished.write_bytes(data)


@contextmanager
def atomic_folder(path: Path, *, replace: bool = False) -> Iterator[Path]:
    """Yield a temporary folder beside `path` to fill; it is renamed to `path` on success."""
    path = Path(path)
    temporary: Path | None = None
    old: Path | None = None
    with storage(path):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            clear_leftovers([path])
            if not replace and path.exists() and not _is_empty_folder(path):
                raise StorageError(
                    f"{path} exists and is not empty; choose another name or remove it"
                )
            temporary = path.with_name(hidden_name(path.name))
            temporary.mkdir()
            temporary.chmod(0o755)
            yield temporary
            if replace and path.exists():
                if path.is_symlink() or not path.is_dir():
                    raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
                old = temporary.with_name(temporary.name + _OLD)
                os.replace(path, old)
            os.replace(temporary, path)
        finally:
            if old is not None and old.exists() and not path.exists():
                os.replace(old, path)
            for folder in (temporary, old):
                if folder is not None:
                    remove_folder(folder)


def _flush(path: Path) -> None:
    """Flush the content before the rename, so that a power cut leaves the old or the new file."""
    with path.open("rb") as file:
        os.fsync(file.fileno())


def _is_empty_folder(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())


def remove_folder(folder: Path) -> None:
    """Remove a folder, if it is still there, although late writers may still write into it.

    SIGTERM takes effect only after that.
    """
    with _undisturbed():
        deadline = time.monotonic() + _LATE_WRITERS_S
        shutil.rmtree(folder, ignore_errors=True)
        while folder.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Hold SIGTERM back until the block is done, because some tools send it repeatedly."""
    if threading.current_thread() is not threading.main_thread():
        # Python runs signal handlers in the main thread only.
        yield
        return
    signals: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: signals.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
        if signals:
            signal.raise_signal(signal.SIGTERM)


def hidden_name(name: str, suffix: str = "") -> str:
    """Return a unique temporary name for what will be called `name`."""
    return f".{name}.{os.urandom(4).hex()}.unfinished{suffix}"


def clear_leftovers(paths: Iterable[Path]) -> None:
    """Remove what killed processes have left of unfinished files and folders.

    The caller must be the only writer of these paths. A folder that a killed process was replacing
    gets its name back.
    """
    wanted = set(paths)
    for folder in {path.parent for path in wanted}:
        with storage(folder):
            for left in folder.glob(".*.unfinished*"):
                found = _UNFINISHED.fullmatch(left.name)
                final = found and left.with_name(found[1] + found[2].removesuffix(_OLD))
                if final not in wanted:
                    continue
                if left.suffix == _OLD and not final.exists():
                    os.replace(left, final)
                elif left.is_dir():
                    shutil.rmtree(left, ignore_errors=True)
                else:
                    left.unlink(missing_ok=True)
