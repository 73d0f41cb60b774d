"""The same work on many items: finished ones are kept, and a failure does not stop the others."""

from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Generic, Protocol, TypeVar, runtime_checkable

from clothtrack.errors import ClothTrackError, StorageError
from clothtrack.files.atomic_write import clear_leftovers
from clothtrack.files.progress import Progress
from clothtrack.files.worker_pool import finished_in_workers

Item = TypeVar("Item")
Result = TypeVar("Result")
_Given_contra = TypeVar("_Given_contra", contravariant=True)
_Made_co = TypeVar("_Made_co", covariant=True)


@runtime_checkable
class Work(Protocol[_Given_contra, _Made_co]):
    """The work to do on items; it is sent to other processes and must hold plain values."""

    def name(self, item: _Given_contra) -> str:
        """Return the item's name, which is unique."""
        ...

    def paths(self, item: _Given_contra) -> Sequence[Path]:
        """Return the paths written for the item, each whole or not at all."""
        ...

    def kept(self, item: _Given_contra) -> _Made_co | None:
        """Return the result if it was finished before; None if it must be made."""
        ...

    def do(self, item: _Given_contra) -> _Made_co:
        """Make the result."""
        ...


@dataclass(frozen=True)
class Attempt(Generic[Item, Result]):
    """The outcome of an item.

    Attributes:
        result: its result, or None.
        error: why there is no result, or None.
    """

    item: Item
    result: Result | None = None
    error: ClothTrackError | None = None


def attempts(
    work: Work[Item, Result],
    items: Sequence[Item],
    *,
    kind: str,
    workers: int = 1,
    ray: str = "",
    device: str = "cpu",
    progress: Progress | None = None,
) -> Generator[Attempt[Item, Result], None, None]:
    """Do the work on every item, and yield each outcome as it is finished.

    The caller must hold the lock of the output folder, and close this as `finished_in_workers`.
    """
    finished = finished_in_workers(
        partial(_attempt, work=work), items, workers, ray=ray, gpus=float(device != "cpu"),
        name=work.name,
    )  # fmt: skip
    paths = [path for item in items for path in work.paths(item)]
    clear_leftovers(paths)
    if progress is not None:
        progress(f"0/{len(items)} {kind}", 0, len(items))
    try:
        with closing(finished):
            for done, one in enumerate(finished, start=1):
                if progress is not None:
                    last = f"{done}/{len(items)} {kind}, the last {work.name(one.item)}"
                    progress(last, done, len(items))
                yield one
    finally:
        # A killed worker leaves half-written files.
        clear_leftovers(paths)


def results_of(
    tries: Iterable[Attempt[Item, Result]],
) -> Generator[tuple[Item, Result], None, None]:
    """Yield items and results; raise the first error after all, but a storage error at once."""
    first: ClothTrackError | None = None
    for one in tries:
        if isinstance(one.error, StorageError):
            raise one.error
        first = first or one.error
        if one.result is not None:
            yield one.item, one.result
    if first is not None:
        raise first


def _attempt(item: Item, *, work: Work[Item, Result]) -> Attempt[Item, Result]:
    """Do the work on an item, unless it was done before."""
    try:
        result = work.kept(item)
        return Attempt(item, work.do(item) if result is None else result)
    except ClothTrackError as error:
        return Attempt(item, error=error)
