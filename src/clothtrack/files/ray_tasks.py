"""The same work on many items with Ray, on this machine or on all machines of a cluster.

It needs the extra [ray], which is imported when the work begins.
"""

import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

from clothtrack.errors import ClothTrackError, InvalidConfigError, StorageError
from clothtrack.files.extras import install_command

Item = TypeVar("Item")
Result = TypeVar("Result")

_LOCAL = "local"
"""The address that starts Ray on this machine, for this program alone."""

_CANCEL_S = 10.0
"""Time for canceled tasks to end [s]."""

_ANSWER_S = 5.0
"""Time for a cluster to accept a connection [s]; Ray itself retries and logs for two minutes."""


def finished_by_ray(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    address: str,
    workers: int,
    *,
    gpus: float,
    name: Callable[[Item], str],
) -> Generator[Result, None, None]:
    """Do the work of `finished_in_workers` with Ray.

    Each item has one processor core. If the worker of an item dies, Ray retries it three times.
    """
    if not items:
        return
    ray = _connected(address, workers)
    task = ray.remote(num_cpus=1, num_gpus=gpus)(_done_in)
    jobs = {task.remote(work, item, os.getcwd()): item for item in items}  # noqa: PTH109
    try:
        while jobs:
            (job,), _ = ray.wait(list(jobs), num_returns=1)
            item = jobs.pop(job)
            yield _result(ray, job, name(item))
    finally:
        _, left = ray.wait(list(jobs), num_returns=len(jobs), timeout=0) if jobs else ([], [])
        for job in left:
            ray.cancel(job, force=True)
        if left:
            ray.wait(left, num_returns=len(left), timeout=_CANCEL_S)


def _result(ray: Any, job: Any, name: str) -> Any:
    try:
        return ray.get(job)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from error
    except ray.exceptions.RayError as error:
        raise ClothTrackError(
            f"{name}: Ray gave it up ({_first_line(error)}); run the same command again: what is "
            "finished is kept"
        ) from error


def _done_in(work: Callable[[Item], Result], item: Item, folder: str) -> Result:
    """Do the work on an item in a worker, in the working directory of the command."""
    from clothtrack.geometry.devices import quiet_warp

    try:
        os.chdir(folder)
    except OSError as error:
        raise StorageError.of(error) from error
    quiet_warp()
    return work(item)


def _connected(address: str, workers: int) -> Any:
    """Return the connected module `ray`; a Ray that this program has already started is reused."""
    os.environ.update(RAY_USAGE_STATS_ENABLED="0", RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO="0")
    if address == _LOCAL and not {"RAY_AUTH_MODE", "ray"} & {*os.environ, *sys.modules}:
        # Its ports are open to the network, so a token protects them. Ray reads it once, on import.
        os.environ.update(RAY_AUTH_MODE="token", RAY_AUTH_TOKEN=os.urandom(32).hex())
    try:
        import ray
    except ModuleNotFoundError as error:
        raise InvalidConfigError(
            f"working with Ray needs {error.name}; install with: {install_command('ray')}"
        ) from error
    options = {"num_cpus": workers, "include_dashboard": False} if address == _LOCAL else {}
    try:
        with _signals_held():
            if not ray.is_initialized():
                host, _, port = address.removeprefix("ray://").rpartition(":")
                if host and port.isdigit():
                    socket.create_connection((host.strip("[]"), int(port)), _ANSWER_S).close()
                ray.init(address, logging_level=logging.ERROR, **options)
    except (OSError, OverflowError, RuntimeError, ValueError) as error:
        raise InvalidConfigError(
            f"Ray at {address!r} does not answer ({_first_line(error)}); give the address of a "
            f"running cluster, or {_LOCAL} to start Ray on this machine"
        ) from error
    return ray


@contextmanager
def _signals_held() -> Iterator[None]:
    """Hold Ctrl-C and SIGTERM back while Ray starts.

    While it starts, Ray loses Ctrl-C and aborts on SIGTERM; it also installs its own handler.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _let_children_be_stopped()
    both = (signal.SIGINT, signal.SIGTERM)
    handlers = [signal.getsignal(number) for number in both]
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, both)
    try:
        yield
    finally:
        for number, handler in zip(both, handlers, strict=True):
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@cache
def _let_children_be_stopped() -> None:
    """Unblock SIGTERM in the processes of Ray, which are started while signals are held back."""
    held = (signal.SIGTERM,)
    os.register_at_fork(after_in_child=lambda: signal.pthread_sigmask(signal.SIG_UNBLOCK, held))


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]
