"""The same work on many items, shared by worker processes, shares of a list, and machines.

Whoever runs the work (`Executor`: worker processes here) is handed items one by one. Each item is
claimed before it is begun, so that any number of processes on one folder finish the work once. One
that another process holds is left to it; at the end its result is waited for, or its claim is taken
over when that process dies.
"""

import re
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from clothtrack.errors import ClothTrackError, InvalidConfigError, StorageError
from clothtrack.files.atomic_write import clear_dead, clear_leftovers
from clothtrack.files.progress import Progress
from clothtrack.files.work_folder import WorkFolder
from clothtrack.files.worker_pool import KILLED, finished_in_workers, require_workers

Item = TypeVar("Item")
Result = TypeVar("Result")
_Given_contra = TypeVar("_Given_contra", contravariant=True)
_Made_co = TypeVar("_Made_co", covariant=True)

POLL_S, LONGEST_POLL_S = 0.2, 5.0
"""What other processes hold is looked at this often [s]: first, and when it takes long."""


@dataclass(frozen=True)
class Share:
    """Which part of a list of items is this process's, and how it was asked for.

    Attributes:
        number: of the part, from 1.
        count: parts in all.
        command: words of the command line that ask for all of it; empty in Python.
    """

    number: int = 1
    count: int = 1
    command: str = ""

    @classmethod
    def parse(cls, text: str, command: str = "") -> "Share":
        """A share as it is written: "3/20" is the third of twenty, "" is all.

        Raises:
            InvalidConfigError: it is no share.
        """
        if not text:
            return cls(command=command)
        written = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        number, count = map(int, written.groups()) if written else (0, 0)
        if not 1 <= number <= count:
            raise InvalidConfigError(
                f"--shard is {text!r}; write I/N with I from 1 to N, such as 1/20 for the first of "
                "twenty parts (Slurm: --array=1-20)"
            )
        return cls(number, count, command)

    def of(self, items: Sequence[Item]) -> list[Item]:
        """Every `count`-th item, so that neighbours, which are often alike, are shared out."""
        return list(items[self.number - 1 :: self.count])


@runtime_checkable
class Work(Protocol[_Given_contra, _Made_co]):
    """What is to be done with items. Other processes get it, so that it holds plain values."""

    def name(self, item: _Given_contra) -> str:
        """What the item is called; no two have one name."""
        ...

    def paths(self, item: _Given_contra) -> Sequence[Path]:
        """What is written for the item, whole or not at all; the last one when all is finished."""
        ...

    def kept(self, item: _Given_contra) -> _Made_co | None:
        """The result, if it was finished before; None when it is to be made."""
        ...

    def do(self, item: _Given_contra) -> _Made_co:
        """Make the result. Only one process does so at a time."""
        ...


@runtime_checkable
class Executor(Protocol):
    """Runs a function on items, somewhere, and gives the results as they come."""

    def __call__(
        self,
        work: Callable[[Any], Any],
        items: Sequence[Any],
        processes: int,
        *,
        lost: Callable[[Any], Any] | None = None,
    ) -> Generator[Any, None, None]:
        """As `finished_in_workers`."""
        ...


@dataclass(frozen=True)
class Attempt(Generic[Item, Result]):
    """What became of an item.

    Attributes:
        item: which.
        result: what was made of it, or None.
        error: why nothing was.
        kept: it had been finished before.
        held: another process works on it.
    """

    item: Item
    result: Result | None = None
    error: ClothTrackError | None = None
    kept: bool = False
    held: bool = False


def attempts(
    work: Work[Item, Result],
    items: Sequence[Item],
    folder: WorkFolder,
    *,
    kind: str,
    processes: int = 1,
    share: Share | None = None,
    progress: Progress | None = None,
    executor: Executor = finished_in_workers,
) -> Generator[Attempt[Item, Result], None, None]:
    """Do this process's share of the work; what became of each of its items, as it comes.

    Close it, as one does with `finished_in_workers`.

    Args:
        work: what is done.
        items: all of them.
        folder: remembers who works on what.
        kind: what the items are, for people, such as "recordings".
        processes: worker processes.
        share: which of the items; all by default.
        progress: called first, after each item, and while others are waited for.
        executor: who runs the work.

    Raises:
        InvalidConfigError: there are no workers.
        StorageError: the folder cannot be written.
    """
    require_workers(processes)
    share = share or Share()
    began = folder.ask(share.command, {work.name(one): work.paths(one)[-1] for one in items})
    left, total, done = (mine := share.of(items)), len(mine), 0

    def tell(last: str) -> None:
        if progress is not None:
            progress(f"{done}/{total} {kind}{last}", done, total)

    places = {path.parent for one in items for path in work.paths(one)}
    clear_dead(places)
    tell("")
    attempt = partial(_attempt, work=work, folder=folder, began=began)
    lost = partial(_lost, work=work, folder=folder)
    try:
        while left:
            held: list[Item] = []
            with closing(executor(attempt, left, processes, lost=lost)) as finished:
                for one in finished:
                    if one.held:
                        held.append(one.item)
                        continue
                    done += 1
                    tell(f", the last {work.name(one.item)}")
                    yield one
            left, pause_s = held, POLL_S
            while left and not any(_free(work, folder, item) for item in left):
                tell(_waiting(work, folder, left))
                time.sleep(pause_s)
                pause_s = min(1.2 * pause_s, LONGEST_POLL_S)
    finally:
        # A worker that was killed, or ended while another of its threads wrote, leaves parts.
        clear_dead(places)
        folder.clear_dead_claims()


def results_of(
    tries: Iterable[Attempt[Item, Result]],
) -> Generator[tuple[Item, Result], None, None]:
    """Items and their results; the first error is raised after them, one of the disk at once.

    Raises:
        ClothTrackError: an item failed.
    """
    first: ClothTrackError | None = None
    for one in tries:
        if isinstance(one.error, StorageError):
            raise one.error
        first = first or one.error
        if one.result is not None:
            yield one.item, one.result
    if first is not None:
        raise first


def _attempt(
    item: Item, *, work: Work[Item, Result], folder: WorkFolder, began: float
) -> Attempt[Item, Result]:
    """Do an item, unless it is done, or somebody else is at it, or has failed at it just now."""
    name = work.name(item)
    try:
        if (result := work.kept(item)) is not None:
            _note_kept(name, folder)
            return Attempt(item, result, kept=True)
        with folder.claimed(name) as mine:
            if not mine:
                return Attempt(item, held=True)
            if (result := work.kept(item)) is not None:
                return Attempt(item, result, kept=True)
            if error := folder.failed_since(name, began):
                return Attempt(item, error=error)
            for path in work.paths(item):
                clear_leftovers(path, claimed=True)
            start = time.monotonic()
            result = work.do(item)
            folder.note_done(name, round(time.monotonic() - start, 2))
            return Attempt(item, result)
    except ClothTrackError as error:
        folder.note_failed(name, error)
        return Attempt(item, error=error)


def _note_kept(name: str, folder: WorkFolder) -> None:
    """Note that an item was found finished, unless who finished it notes so, and in how long."""
    if folder.record(name).get("status") == "done":
        return
    with folder.claimed(name) as mine:
        if mine and folder.record(name).get("status") != "done":
            folder.note_done(name, None)


def _lost(item: Item, *, work: Work[Item, Result], folder: WorkFolder) -> Attempt[Item, Result]:
    name = work.name(item)
    error = ClothTrackError(f"{name}: {KILLED}")
    # The claim of the dead worker goes, too.
    with folder.claimed(name):
        folder.note_failed(name, error)
    return Attempt(item, error=error)


def _free(work: Work[Item, Result], folder: WorkFolder, item: Item) -> bool:
    holder = folder.holder(work.name(item))
    return holder is None or not holder.lives


def _waiting(work: Work[Item, Result], folder: WorkFolder, left: Sequence[Item]) -> str:
    holder = folder.holder(work.name(left[0]))
    whose = f" ({holder.owner.host}, process {holder.owner.pid})" if holder else ""
    more = f" and {len(left) - 1} more" if len(left) > 1 else ""
    return f", waiting for {work.name(left[0])}{whose}{more}"
