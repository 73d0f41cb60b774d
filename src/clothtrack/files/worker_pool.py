"""The same work on many items: in this process, in worker processes, or with Ray."""

import ctypes
import os
import signal
import sys
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing import active_children, get_context, parent_process
from typing import TypeVar

from clothtrack.errors import ClothTrackError, InvalidConfigError

Item = TypeVar("Item")
Result = TypeVar("Result")

_PR_SET_PDEATHSIG = 1


def require_workers(number: int) -> None:
    """Refuse a number of worker processes below 1."""
    if number < 1:
        raise InvalidConfigError(f"the number of workers is {number}; give at least 1")


def start_worker() -> None:
    """Make this worker process quiet, let it ignore Ctrl-C and SIGTERM, and end with its parent.

    Only the parent handles signals, which a terminal or a scheduler sends to all processes of a
    group. It kills its workers.
    """
    # Imported here, because training loads this module without Warp and starts no worker.
    from clothtrack.geometry.devices import quiet_warp

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    parent = parent_process()
    if parent is not None and os.getppid() != parent.pid:
        os._exit(1)  # The parent died before the kernel was asked.
    quiet_warp()


def finished_in_workers(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    workers: int,
    *,
    ray: str = "",
    gpus: float = 0.0,
    name: Callable[[Item], str] = str,
) -> Generator[Result, None, None]:
    """Do the same work on many items, and yield the results in the order in which they finish.

    Close it (`contextlib.closing`), so that an interrupt or an error kills the workers at once. The
    caller must then remove half-written files.
    """
    require_workers(workers)
    if ray:
        from clothtrack.files.ray_tasks import finished_by_ray

        yield from finished_by_ray(work, items, ray, workers, gpus=gpus, name=name)
    elif workers == 1 or len(items) <= 1:
        yield from map(work, items)
    else:
        yield from _finished_in_pool(work, items, workers, name)


def _finished_in_pool(
    work: Callable[[Item], Result], items: Sequence[Item], workers: int, name: Callable[[Item], str]
) -> Generator[Result, None, None]:
    waiting = iter(items)
    jobs: dict[Future[Result], Item] = {}
    others = set(active_children())
    with ProcessPoolExecutor(workers, get_context("spawn"), start_worker) as pool:
        try:
            while True:
                # Submit no more items than there are workers: every submitted item is in progress.
                for item in islice(waiting, workers - len(jobs)):
                    jobs[pool.submit(work, item)] = item
                if not jobs:
                    break
                done, _ = wait(jobs, return_when=FIRST_COMPLETED)
                # Yield finished results first, even if another worker has died.
                for job in sorted(done, key=lambda job: job.exception() is not None):
                    result = job.result()
                    del jobs[job]
                    yield result
        except BrokenProcessPool as error:
            raise ClothTrackError(
                f"a worker process died (out of memory?) while these were under way: "
                f"{', '.join(map(name, jobs.values()))}; give fewer workers, and run the same "
                "command again: what is finished is kept"
            ) from error
        finally:
            for process in set(active_children()) - others:
                process.kill()
