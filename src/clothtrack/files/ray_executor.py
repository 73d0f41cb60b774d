"""Ray in place of worker processes: on this machine, or on all machines of a cluster.

It needs the extra [ray], which is imported when the first item is worked on.
"""

import atexit
import logging
import os
import pickle
import shutil
import signal
import socket
import sys
import tempfile
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.files.bounds import Checked, NotNegative
from clothtrack.files.extras import install_command
from clothtrack.files.worker_pool import KILLED, PATIENCE_S, require_workers
from clothtrack.geometry.devices import quiet_warp

Item = TypeVar("Item")
Result = TypeVar("Result")

HERE = "local"
TRIES = 3
"""An item is lost when so many workers were killed at it; at the last try it is alone."""

_STORE_BYTES = 100 * 2**20
"""Of memory for objects, which Ray takes at its start; our items and results are small."""

_ANSWER_S = 5.0
"""Longest wait for somebody to listen at an address [s]."""

_Logged = tuple[str, int, str]


@dataclass(frozen=True)
class RayExecutor(Checked):
    """Runs work by Ray, as `clothtrack.files.shared_work.Executor`; an item has one processor core.

    A Ray that this program has started already is used as it is.

    Attributes:
        address: of a running cluster, such as "auto" or "ray://host:10001"; "local" starts Ray on
            this machine, for this program alone.
        memory_gb: memory that Ray keeps free for each item [10^9 bytes]; 0: it does not ask.
        gpus: graphics cards per item; a fraction is shared.
    """

    address: str = HERE
    memory_gb: NotNegative = 0.0
    gpus: NotNegative = 0.0
    _killed: Counter[str] = field(default_factory=Counter, init=False, repr=False, compare=False)

    def __call__(
        self,
        work: Callable[[Item], Result],
        items: Sequence[Item],
        processes: int,
        *,
        lost: Callable[[Item], Result] | None = None,
    ) -> Generator[Result, None, None]:
        """Do the same work on many items; results as they come. Close it after an interrupt.

        What is logged in a worker is logged here. A worker that is killed costs its own item, which
        is tried again after the others, and a third time alone.

        Args:
            work: a function that other processes can be sent.
            items: what to work on.
            processes: workers on this machine; a cluster has as many as it has cores.
            lost: the result of an item whose worker was killed at every try.

        Raises:
            InvalidConfigError: Ray is not installed or does not answer, there are no workers, or no
                machine has so much memory or so many cards.
            ClothTrackError: workers were killed at every try and `lost` is not given; after all
                results.
        """
        require_workers(processes)
        dead: list[Item] = []
        if items:
            ray = _started(self.address, processes)
            self._require_room(ray.nodes())
            yield from self._results(ray, work, items, processes, dead)
        if lost is not None:
            yield from map(lost, dead)
        elif dead:
            raise ClothTrackError(f"{len(dead)} of {len(items)}: {KILLED}")

    def _results(
        self, ray: Any, work: Callable[[Any], Any], items: Sequence[Any], here: int, dead: list[Any]
    ) -> Generator[Any, None, None]:
        """The results; items are put into `dead` when all their workers were killed."""
        wanted = {"memory": int(1e9 * self.memory_gb), "num_gpus": self.gpus, "num_cpus": 1}
        # Ray's own tries would come at once, beside the others that use the memory up.
        task = ray.remote(max_retries=0, **{name: it for name, it in wanted.items() if it})(_made)
        left, alone, running = deque(items), deque[Any](), {}
        done = killed = 0
        try:
            while left or alone or running:
                most = here if self.address == HERE else _cores(ray)
                at_once = most if done or killed < 2 * most else 1
                while (left and len(running) < at_once) or (alone and not (left or running)):
                    item = (left or alone).popleft()
                    running[task.remote(work, item, str(Path.cwd()))] = item
                (job,), _ = ray.wait(list(running), num_returns=1)
                # What has ended must not be cancelled: Ray itself aborts if that comes too soon.
                item = running.pop(job)
                result = _result(ray, job)
                if result is not None:
                    self._killed.pop(repr(item), None)
                    done += 1
                    yield pickle.loads(result)
                    continue
                killed += 1
                self._killed[repr(item)] += 1
                tries = self._killed[repr(item)]
                (left if tries == 1 else alone if tries < TRIES else dead).append(item)
                if not done and killed >= 3 * most + 2:
                    # Nothing was finished, not even by workers alone: it is no item's fault.
                    dead += [*left, *alone]
                    left.clear()
                    alone.clear()
        finally:
            for item in dead:
                self._killed.pop(repr(item), None)
            _end(ray, list(running))

    def _require_room(self, machines: Sequence[Mapping[str, Any]]) -> None:
        """Refuse an item for which Ray would look for a machine for ever."""
        for name, word, unit, wanted in (
            ("memory", "GB of memory", 1e9, self.memory_gb),
            ("GPU", "graphics cards", 1.0, self.gpus),
        ):
            most = max((one["Resources"].get(name, 0.0) / unit for one in machines), default=0.0)
            if wanted > most:
                raise InvalidConfigError(
                    f"an item is to have {wanted:g} {word}, and the largest machine of Ray "
                    f"({self.address}) has {most:.3g}; ask for less"
                )


def _started(address: str, processes: int) -> Any:
    """Ray, at work; it ends with this process."""
    # Nobody is told that it is used; what it says of workers would stand among results.
    os.environ.update(RAY_USAGE_STATS_ENABLED="0", RAY_DEDUP_LOGS_SKIP_REGEX=".*")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    if address == HERE and not {"RAY_AUTH_MODE", "ray"} & {*os.environ, *sys.modules}:
        # Its ports are open to the network: only who has the token may use them. It is read once,
        # when Ray is imported.
        os.environ.update(RAY_AUTH_MODE="token", RAY_AUTH_TOKEN=os.urandom(32).hex())
    try:
        import ray
    except ModuleNotFoundError as error:
        raise InvalidConfigError(
            f"working with Ray needs {error.name}; install with: {install_command('ray')}"
        ) from error
    if ray.is_initialized():
        return ray
    _require_listener(address)
    options: dict[str, Any] = {}
    if address == HERE:
        # Sockets lie in it, whose names may have 107 characters.
        logs = tempfile.mkdtemp(prefix="ray-", dir="/tmp")
        atexit.register(shutil.rmtree, logs, ignore_errors=True)
        options = {
            "num_cpus": processes, "object_store_memory": _STORE_BYTES, "_temp_dir": logs,
            "include_dashboard": False,
        }  # fmt: skip
    with _own_signals():
        try:
            ray.init(address, logging_level=logging.CRITICAL, log_to_driver=False, **options)
        except (ConnectionError, RuntimeError, ValueError) as error:
            line = str(error).strip().partition("\n")[0]
            raise InvalidConfigError(
                f"Ray at {address!r} does not answer ({line}); give the address of a running "
                f"cluster, or {HERE} to start Ray on this machine"
            ) from error
    return ray


def _require_listener(address: str) -> None:
    """Refuse an address where nobody listens; Ray would try for minutes, and log every try."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not (host and port.isdigit()):
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=_ANSWER_S).close()
    except (OSError, OverflowError) as error:
        raise InvalidConfigError(
            f"Ray at {address!r} does not answer ({error}); give the address of a running "
            f"cluster, or {HERE} to start Ray on this machine"
        ) from error


@contextmanager
def _own_signals() -> Iterator[None]:
    """Ray's start replaces what SIGTERM does, and with it how a command line ends."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _cores(ray: Any) -> int:
    # More than there are: a cluster that can grow does so for what waits.
    return 2 * max(1, int(ray.cluster_resources().get("CPU", 1.0)))


def _result(ray: Any, job: Any) -> bytes | None:
    """What a worker gave, None where it was killed; what it logged is logged here."""
    from ray import exceptions as told

    try:
        result, logged = ray.get(job)
    except told.RayTaskError as error:
        raise (error.cause if isinstance(error.cause, Exception) else error) from error
    except (
        told.WorkerCrashedError, told.OutOfMemoryError, told.NodeDiedError,
        told.LocalRayletDiedError, told.ObjectLostError,
    ):  # fmt: skip
        return None
    except told.RayError as error:
        raise ClothTrackError(f"Ray gave up: {str(error).strip()}") from error
    for name, level, text in logged:
        logging.getLogger(name).log(level, "%s", text)
    return result


def _end(ray: Any, running: list[Any]) -> None:
    """End tasks as an interrupt does: each clears away, or is killed after a while."""
    if not (running and ray.is_initialized()):
        return
    _, left = ray.wait(running, num_returns=len(running), timeout=0.0)
    for job in left:
        ray.cancel(job)
    if left:
        _, deaf = ray.wait(left, num_returns=len(left), timeout=PATIENCE_S)
        for job in deaf:
            ray.cancel(job, force=True)


class _Records(logging.Handler):
    """Keeps warnings."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.found: list[_Logged] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep one."""
        self.found.append((record.name, record.levelno, record.getMessage()))


def _made(work: Callable[[Any], Any], item: Any, place: str) -> tuple[bytes, list[_Logged]]:
    """In a worker: what is made of an item, and the warnings on the way."""
    try:
        os.chdir(place)
    except OSError as error:
        raise InvalidConfigError(
            f"{socket.gethostname()}: {place} is not there ({error.strerror}); all machines of a "
            "Ray cluster must see the folder of the command"
        ) from error
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        # What a shell starts in the background ignores it, and its workers do; Ray interrupts so.
        signal.signal(signal.SIGINT, signal.default_int_handler)
    quiet_warp()
    records, root = _Records(), logging.getLogger()
    root.addHandler(records)
    try:
        # Bytes, because the arrays in Ray's own messages cannot be written to.
        return pickle.dumps(work(item)), records.found
    finally:
        root.removeHandler(records)
