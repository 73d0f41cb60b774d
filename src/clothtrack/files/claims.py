"""Claims: which process works on what, in a folder that several processes and machines share.

A claim is a file `NAME.0` that only one process can make (O_EXCL, which holds on NFS from version
3). It names its owner, who renews its time of change once a minute. A claim whose owner is dead is
taken over by whoever makes `NAME.1`, and so on: again only one can. Of an owner on the same machine
everybody knows at once whether it lives; one on another machine is given up after `LEASE_S`.
"""

import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from clothtrack.files.atomic_write import clear_dead, storage, undisturbed
from clothtrack.files.owner import Owner, hidden_name

LEASE_S = 300.0
"""A claim from another machine that was not renewed for so long [s] may be taken over."""

RENEW_S = 60.0
"""A claim is renewed this often [s]."""

_LOCK_POLL_S = 0.05


@dataclass(frozen=True)
class Holder:
    """Who holds a claim.

    Attributes:
        owner: the process.
        since: when it began [s since 1970, its own clock].
        lives: whether the claim still counts.
    """

    owner: Owner
    since: float
    lives: bool


@contextmanager
def claimed(folder: Path, name: str) -> Iterator[bool]:
    """Hold the claim to `name` for the time of the block; False where another process holds it.

    Args:
        folder: of the claims; made when it is not there.
        name: of what is claimed.

    Raises:
        StorageError: the disk refuses.
    """
    path, ended = None, threading.Event()
    try:
        # An interrupt between the claim and the `try` that gives it up would leave it behind.
        with undisturbed():
            path = _take(folder, name)
            if path is not None:
                threading.Thread(target=_renew, args=(path, ended), daemon=True).start()
        yield path is not None
    finally:
        ended.set()
        if path is not None:
            path.unlink(missing_ok=True)


@contextmanager
def locked(folder: Path, name: str) -> Iterator[None]:
    """Wait for the claim to `name`, and hold it for the time of the block, which must be short.

    Raises:
        StorageError: the disk refuses.
    """
    while True:
        with claimed(folder, name) as mine:
            if mine:
                yield
                return
        time.sleep(_LOCK_POLL_S)


def holder_of(folder: Path, name: str) -> Holder | None:
    """Who holds the claim to `name`, alive or not; None when nobody does."""
    paths = _paths(folder, name)
    read = _read(paths[-1]) if paths else None
    if read is None:
        return None
    text, changed = read
    owner, since = _parsed(text)
    if owner is None:
        owner, since = Owner("an unknown machine", "", 0, 0), changed
    return Holder(owner, since, _lives(folder, text, changed))


def clear_dead_claims(folder: Path) -> None:
    """Remove the claims of dead processes of this machine, and what they left while they made them.

    Raises:
        StorageError: the disk refuses.
    """
    clear_dead([folder])
    for path in folder.glob("[!.]*"):
        read = _read(path)
        owner = None if read is None else _parsed(read[0])[0]
        if owner is not None and owner.alive is False:
            # Not by its name alone: somebody may be about to take it over.
            with claimed(folder, path.stem):
                pass


def file_time(folder: Path) -> float:
    """The time [s since 1970] by the clock of the disk, which all machines see alike."""
    probe = folder / hidden_name("now")
    with storage(folder):
        folder.mkdir(parents=True, exist_ok=True)
        try:
            with probe.open("xb") as file:
                return os.fstat(file.fileno()).st_mtime
        finally:
            probe.unlink(missing_ok=True)


def _take(folder: Path, name: str) -> Path | None:
    """Make the claim, or take a dead one over; None where somebody else has it or is faster."""
    with storage(folder):
        folder.mkdir(parents=True, exist_ok=True)
    earlier = _paths(folder, name)
    number, dead = 0, None
    if earlier:
        read = _read(earlier[-1])
        if read is None or _lives(folder, *read):
            return None
        dead = read[0]
        number = _number(earlier[-1]) + 1
    path = folder / f"{name}.{number}"
    text = json.dumps(
        {**Owner.me().as_dict(), "since": round(time.time(), 1), "token": os.urandom(8).hex()}
    )
    with storage(path):
        try:
            with path.open("x", encoding="ascii") as file:
                file.write(text)
        except FileExistsError:
            return None
        except OSError:
            # The disk took the name and not the content: others would wait for nobody.
            path.unlink(missing_ok=True)
            raise
    # Between our look and our file another process may have finished with all of them, and a third
    # one begun: then ours is one too many.
    again = _read(earlier[-1]) if earlier else None
    if _paths(folder, name)[-1:] != [path] or (again[0] if again else None) != dead:
        path.unlink(missing_ok=True)
        return None
    for old in earlier:
        old.unlink(missing_ok=True)
    return path


def _paths(folder: Path, name: str) -> list[Path]:
    """The claims to `name`; the last one counts."""
    try:
        found = [path for path in folder.iterdir() if path.name.rpartition(".")[0] == name]
    except FileNotFoundError:
        return []
    return sorted((path for path in found if path.suffix[1:].isdigit()), key=_number)


def _number(path: Path) -> int:
    return int(path.suffix[1:])


def _read(path: Path) -> tuple[str, float] | None:
    """What a claim says, and when it was renewed; None when it is gone."""
    try:
        # An open file is asked for anew; the name alone may be remembered for a minute on NFS.
        with path.open(encoding="ascii") as file:
            return file.read(), os.fstat(file.fileno()).st_mtime
    except FileNotFoundError:
        return None


def _parsed(text: str) -> tuple[Owner | None, float]:
    with suppress(ValueError, TypeError, KeyError, RecursionError):
        document = json.loads(text)
        return Owner.of(document), float(document["since"])
    return None, 0.0


def _lives(folder: Path, text: str, changed: float) -> bool:
    """Whether a claim counts."""
    owner, _ = _parsed(text)
    alive = None if owner is None else owner.alive
    return file_time(folder) - changed < LEASE_S if alive is None else alive


def _renew(path: Path, ended: threading.Event) -> None:
    while not ended.wait(RENEW_S):
        with suppress(OSError):
            os.utime(path)
