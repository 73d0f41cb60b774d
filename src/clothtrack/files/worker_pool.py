"""Worker processes: how many, how they start, and that they end when their parent does."""

import ctypes
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ALL_COMPLETED, FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_context, parent_process
from types import FrameType
from typing import TypeVar

from clothtrack.errors import ClothTrackError, InvalidConfigError

Item = TypeVar("Item")
Result = TypeVar("Result")

PATIENCE_S = 10.0
"""How long workers may take to clear away what is half-written before they are killed [s]."""

KILLED = (
    "the worker process was killed, also when no other worked beside it (out of memory?); free "
    "some memory, or take a machine with more, and run the same command again: what is finished "
    "is kept"
)

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
    # Training imports this module where Warp is not installed, and starts no worker there.
    from clothtrack.geometry.devices import quiet_warp

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
    work: Callable[[Item], Result],
    items: Sequence[Item],
    processes: int,
    *,
    lost: Callable[[Item], Result] | None = None,
) -> Generator[Result, None, None]:
    """Do the same work on many items, in this process or in several; results as they come.

    No other module starts a pool, so that all of them end in the same way: after an interrupt or
    an error no worker begins anything or goes on; each clears away what it has half-written, as
    the work's own `finally` blocks say, or is killed after a while.

    An interrupt may also come while the caller is busy with a result: close the results then
    (`contextlib.closing`), or the workers go on for as long as a traceback holds on to them.

    A worker that is killed (out of memory?) costs nothing but time: the others go on, and at the
    end what it was at is tried again, alone.

    Args:
        work: a function of a module, so that a worker can find it.
        items: what to work on, handed to the workers in this order.
        processes: how many; one works right here.
        lost: the result of an item whose worker was killed when it was tried alone, too.

    Raises:
        InvalidConfigError: when there are no workers.
        ClothTrackError: workers were killed alone, too, and `lost` is not given; after all results.
    """
    require_workers(processes)
    if processes == 1 or len(items) <= 1:
        yield from map(work, items)
        return
    left: deque[Item] = deque(items)
    suspects: list[Item] = []
    while left:
        suspects += yield from _until_one_is_killed(work, left, processes)
        if len(suspects) == len(items) - len(left) >= 2 * processes:
            break  # Nothing was finished: it may be no item's fault.
    dead: list[Item] = []
    for number, item in enumerate(alone := [*suspects, *left]):
        dead += yield from _until_one_is_killed(work, deque([item]), 1)
        if left and len(dead) == number + 1 >= 2:
            # Alone neither of the first two was finished: it is no item's fault.
            dead += alone[number + 1 :]
            break
    if lost is not None:
        yield from map(lost, dead)
    elif dead:
        raise ClothTrackError(f"{len(dead)} of {len(items)}: {KILLED}")


def _until_one_is_killed(
    work: Callable[[Item], Result], left: deque[Item], processes: int
) -> Generator[Result, None, list[Item]]:
    """Take items from `left` until a worker is killed; gives what was in work then."""
    jobs: dict[Future[Result], Item] = {}
    killed = False
    with ProcessPoolExecutor(processes, get_context("spawn"), _start_stoppable_worker) as pool:
        try:
            while jobs or (left and not killed):
                # No more than there are workers: what is handed out is what may have killed one.
                while left and not killed and len(jobs) < processes:
                    try:
                        job = pool.submit(_work_or_leave, work, left[0])
                    except BrokenProcessPool:
                        killed = True
                    else:
                        jobs[job] = left.popleft()
                wait(jobs, return_when=ALL_COMPLETED if killed else FIRST_COMPLETED)
                for job in [job for job in jobs if job.done()]:
                    if isinstance(job.exception(), BrokenProcessPool):
                        killed = True
                    else:
                        jobs.pop(job)
                        yield job.result()
                if killed and all(job.done() for job in jobs):
                    break
        finally:
            if jobs or left:
                # The pool finds its workers gone and ends; it is waited for, because one that ends
                # while the interpreter does may complain of a pipe that it has closed itself.
                end_workers()
    return list(jobs.values())


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
