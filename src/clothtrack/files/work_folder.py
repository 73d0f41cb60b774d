"""What a folder of results remembers of the work in it, for all processes that share it.

    OUT/.work/VERB/asked/*.json    what was asked for: the command, the items and their results
    OUT/.work/VERB/items/*.json    what became of an item: done in how long, or failed and why
    OUT/.work/VERB/claims/*        who works on what (`clothtrack.files.claims`)

Each item has a file of its own, so that nobody writes what another one writes.
"""

import hashlib
import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Any

from clothtrack import errors
from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.files.atomic_write import write_file
from clothtrack.files.claims import Holder, claimed, clear_dead_claims, file_time, holder_of, locked
from clothtrack.files.owner import Owner

HIDDEN = ".work"

_WHOLE = "all"
"""What `alone` claims; no item is called so in the same verb."""

LARGEST = 2**53
"""Numbers in these files are smaller."""

Record = dict[str, Any]
"""What became of an item: status ("done" or "failed"), seconds, host, pid, error, kind."""


@dataclass(frozen=True)
class WorkFolder:
    """The memory of one verb in one folder of results.

    Attributes:
        out: the folder of results.
        verb: as it is written on the command line.
    """

    out: Path
    verb: str

    @property
    def folder(self) -> Path:
        """Where the files lie."""
        return self.out / HIDDEN / self.verb

    def ask(self, command: str, results: Mapping[str, Path]) -> float:
        """Note what is asked for; gives the time of the disk at which that was.

        Args:
            command: the words of the command line, without the share; empty where there are none.
            results: where the result of each item is to lie, by its name.

        Raises:
            StorageError: the disk refuses.
        """
        places = {name: os.path.relpath(path, self.out) for name, path in results.items()}
        text = json.dumps({"command": command, "items": places}, indent=1)
        # The same work has the same name, whoever asks for it.
        name = hashlib.sha256(text.encode()).hexdigest()[:16]
        path = self.folder / "asked" / f"{name}.json"
        if not path.exists():
            write_file(path, text.encode())
        return file_time(self.folder / "claims")

    def asked(self) -> list[dict[str, Any]]:
        """All that was asked for, the latest last; what is damaged was not."""
        paths = sorted((self.folder / "asked").glob("[0-9a-f]*.json"), key=_changed)
        return [found for path in paths if _is_asked(found := _json(path) or {})]

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Be the only process at this verb in this folder, for the time of the block.

        For work whose parts depend on each other, so that it cannot be shared out.

        Raises:
            InvalidConfigError: another process is; with its machine, its number and since when.
        """
        while True:
            with self.claimed(_WHOLE) as mine:
                if mine:
                    yield
                    return
            if (holder := self.holder(_WHOLE)) is not None:
                since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(holder.since))
                raise InvalidConfigError(
                    f"{self.out}: {self.verb} is at work here already ({holder.owner.host}, "
                    f"process {holder.owner.pid}, since {since}); wait until it ends, or choose "
                    "another folder"
                )

    def claimed(self, name: str) -> AbstractContextManager[bool]:
        """Hold the claim to an item (`claims.claimed`)."""
        return claimed(self.folder / "claims", name)

    def locked(self, name: str) -> AbstractContextManager[None]:
        """Have a file that all write for oneself (`claims.locked`)."""
        return locked(self.folder / "claims", name)

    def clear_dead_claims(self) -> None:
        """Remove the claims of dead processes of this machine."""
        clear_dead_claims(self.folder / "claims")

    def holder(self, name: str) -> Holder | None:
        """Who has the claim to an item."""
        return holder_of(self.folder / "claims", name)

    def note_done(self, name: str, seconds: float | None) -> None:
        """Note that an item is finished, and how long it took [s]; None where nobody knows."""
        self._note(name, {"status": "done", "seconds": seconds})

    def note_failed(self, name: str, error: ClothTrackError) -> None:
        """Note that an item failed, and why."""
        self._note(name, {"status": "failed", "error": str(error), "kind": type(error).__name__})

    def record(self, name: str) -> Record:
        """What became of an item; empty where nothing has yet, without what is damaged."""
        found = _json(self._path(name)) or {}
        return {key: found[key] for key, kind in _FIELDS.items() if _fits(found.get(key), kind)}

    def failed_since(self, name: str, time_s: float) -> ClothTrackError | None:
        """Why an item has failed since a time of the disk; None when it has not."""
        with suppress(OSError):
            if _changed(self._path(name)) >= time_s:
                record = self.record(name)
                if record.get("status") == "failed":
                    kind = getattr(errors, str(record.get("kind")), ClothTrackError)
                    return kind(str(record.get("error")))
        return None

    def _path(self, name: str) -> Path:
        return self.folder / "items" / f"{name}.json"

    def _note(self, name: str, record: Record) -> None:
        me = Owner.me()
        whole = {**record, "host": me.host, "pid": me.pid, "ended": round(time.time(), 1)}
        write_file(self._path(name), json.dumps(whole).encode())


def verbs_of(out: Path) -> list[WorkFolder]:
    """The memory of every verb that has worked in a folder."""
    return [WorkFolder(out, path.name) for path in sorted((out / HIDDEN).glob("[a-z]*"))]


_FIELDS: Mapping[str, type | UnionType] = {
    "status": str, "seconds": int | float, "host": str, "pid": int, "error": str, "kind": str,
    "ended": int | float,
}  # fmt: skip


def _fits(value: object, kind: type | UnionType) -> bool:
    # Python reads NaN, and whole numbers that are no float.
    is_large = isinstance(value, int | float) and not abs(value) < LARGEST
    return isinstance(value, kind) and not is_large


def _is_asked(found: Mapping[str, Any]) -> bool:
    """Whether a document says what was asked for."""
    items = found.get("items")
    return (
        isinstance(found.get("command"), str)
        and isinstance(items, dict)
        and all(isinstance(place, str) and "\0" not in place for place in items.values())
    )


def _changed(path: Path) -> float:
    return path.stat().st_mtime


def _json(path: Path) -> dict[str, Any] | None:
    """A file that somebody may be about to write for the first time, or has damaged."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None
