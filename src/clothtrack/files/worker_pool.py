"""Worker processes: how many, how they start, and that they end when their parent does."""

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_context, parent_process
from types import FrameType
from typing import TypeVar

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.geometry.devices import quiet_warp

Item = TypeVar("Item")
Result = TypeVar("Result")

PATIENCE_S = 10.0
"""How long workers may take to clear away what is half-written before they are killed [s]."""

_ASK_AGAIN_S = 0.5
_PR_SET_PDEATHSIG = 1


def require_workers(number: int) -> None:
    """Refuse a number of worker processes that cannot be.

    Raises:
        InvalidConfigError: with the number.
    """
    if number < 1:
        raise InvalidConfigError(f"the number of workers is {number}; give at least 1")


def start_worker() -> None:
    """A worker is silent, leaves an interrupt from the keyboard to its parent, and ends with it.

    Call it in the worker. A parent that was killed cannot end its workers.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        # The thread below waits its turn while compiled code computes; the kernel does not.
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    quiet_warp()


def _leave_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def end_workers(patience_s: float = PATIENCE_S) -> None:
    """Tell all worker processes to end until they have; kill those that do not in time.

    Telling them once is not enough: an exception that a signal raises is lost when it comes up
    where Python ignores exceptions, such as in a destructor.
    """
    deadline = time.monotonic() + patience_s
    while (alive := active_children()) and time.monotonic() < deadline:
        for process in alive:
            process.terminate()
        alive[0].join(_ASK_AGAIN_S)
    for process in active_children():
        process.kill()
        process.join()


def finished_in_workers(
    work: Callable[[Item], Result], items: Sequence[Item], processes: int
) -> Generator[Result, None, None]:
    """Do the same work on many items, in this process or in several; results as they come.

    No other module starts a pool, so that all of them end in the same way: after an interrupt or
    an error no worker begins anything or goes on; each clears away what it has half-written, as
    the work's own `finally` blocks say, or is killed after a while.

    An interrupt may also come while the caller is busy with a result: close the results then
    (`contextlib.closing`), or the workers go on for as long as a traceback holds on to them.

    Args:
        work: a function of a module, so that a worker can find it.
        items: what to work on, handed to the workers in this order.
        processes: how many; one works right here.

    Raises:
        InvalidConfigError: when there are no workers.
        ClothTrackError: when a worker was killed; after the results of what is finished.
    """
    require_workers(processes)
    if processes == 1 or len(items) <= 1:
        yield from map(work, items)
        return
    jobs: list[Future[Result]] = []
    lost: list[Future[Result]] = []
    with ProcessPoolExecutor(processes, get_context("spawn"), _start_stoppable_worker) as pool:
        try:
            jobs.extend(pool.submit(_work_or_leave, work, item) for item in items)
            for job in as_completed(jobs):
                if isinstance(job.exception(), BrokenProcessPool):
                    lost.append(job)
                else:
                    yield job.result()
            for job in lost:
                job.result()
        except BrokenProcessPool as error:
            raise ClothTrackError(
                "a worker process was killed (out of memory?); use fewer workers and run again: "
                "what is finished is kept"
            ) from error
        finally:
            if lost or len(jobs) < len(items) or not all(job.done() for job in jobs):
                # The pool finds its workers gone and ends; it is waited for, because one that ends
                # while the interpreter does may complain of a pipe that it has closed itself.
                # What has not begun is not cancelled: the pool stumbles over that while it ends.
                end_workers()


def _work_or_leave(work: Callable[[Item], Result], item: Item) -> Result:
    try:
        return work(item)
    except SystemExit:
        # What was half-written is gone by now. A pool hands any exception of a task back to its
        # parent and goes on with the next one; this worker was told to end.
        os._exit(1)


def _start_stoppable_worker() -> None:
    start_worker()
    signal.signal(signal.SIGTERM, _leave)
    sys.unraisablehook = _report_unless_leaving


def _leave(_signal: int, _frame: FrameType | None) -> None:
    sys.exit(1)


def _report_unless_leaving(lost: "sys.UnraisableHookArgs") -> None:
    """Being told to end inside a destructor is no fault to report: it will be told again."""
    if not isinstance(lost.exc_value, SystemExit):
        sys.__unraisablehook__(lost)
