"""Run a command line in a forked child and record its output and cost, or kill it any time.

Modules imported before the fork are not imported again, so that thousands of runs are feasible. The
parent must not have computed anything, because threads do not survive a fork.
"""

import ctypes
import gc
import io
import json
import os
import re
import resource
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MOST_CPU_S = 30
"""A run that computes for longer is stopped and counts as hanging [s]."""

MOST_WALL_S = 300.0
"""The same for one that waits [s]."""

MOST_MEMORY = 2 * 2**30
"""Memory that a run may take beyond what the parent has [bytes]."""

CRASHED = 70
"""Exit code of a run that ended with an exception that nobody caught."""

_CHANGES = ("os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.link", "os.symlink")
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
_PROGRESS = re.compile(r" *\d+ %  |.*: first mesh$")


@dataclass(frozen=True)
class Limits:
    """How a run is disturbed, or held.

    Attributes:
        kill_cpu_s: SIGKILL after so much CPU time [s]; None: never.
        kill_change: SIGKILL before the n-th change of the file system, from 0; None: never.
        file_bytes: no file may grow beyond; None: any.
        cpu_s: CPU time after which it is stopped [s].
        folder: the only folder in which it may write, beside temporary ones; None: any.
    """

    kill_cpu_s: float | None = None
    kill_change: int | None = None
    file_bytes: int | None = None
    cpu_s: int = MOST_CPU_S
    folder: Path | None = None


@dataclass(frozen=True)
class Trial:
    """What became of a run.

    Attributes:
        code: exit code; minus the signal that ended it.
        out: standard output.
        complaints: lines on standard error but those of progress.
        cpu_s: CPU time [s].
        peak_bytes: most resident memory, with what the parent had [bytes].
        changes: of the file system.
        outside: files that it opened to write outside its folder.
    """

    code: int
    out: str
    complaints: tuple[str, ...]
    cpu_s: float
    peak_bytes: int
    changes: int
    outside: tuple[str, ...]


def run(
    words: Sequence[object] | Callable[[], Sequence[object]],
    box: Path,
    *,
    limits: Limits | None = None,
    before: Callable[[], None] | None = None,
) -> Trial:
    """Run the command line in a child.

    Args:
        words: after `clothtrack`; or what makes them, and what they name, in the child.
        box: folder that is the child's working directory, and gets `out`, `err` and `changes`.
        limits: how it is disturbed; by default only what hangs is stopped.
        before: called in the child first, to make a world smaller.
    """
    limits = limits or Limits()
    told = {name: box / f".trial-{name}" for name in ("out", "err", "changes")}
    sys.stdout.flush()
    sys.stderr.flush()
    gc.freeze()
    child = os.fork()
    if child == 0:
        _child(words, box, told, limits, before)
    late = threading.Timer(MOST_WALL_S, os.kill, (child, signal.SIGKILL))
    late.start()
    _, status, used = os.wait4(child, 0)
    late.cancel()
    texts = {name: _taken(path) for name, path in told.items()}
    changes, _, outside = texts["changes"].partition("\n")
    lines = [line for line in texts["err"].splitlines() if not _PROGRESS.match(line)]
    return Trial(
        code=os.waitstatus_to_exitcode(status),
        out=texts["out"],
        complaints=tuple(line for line in lines if line.strip()),
        cpu_s=used.ru_utime + used.ru_stime,
        peak_bytes=1024 * used.ru_maxrss,
        changes=int(changes or 0),
        outside=tuple(outside.splitlines()),
    )


def child_result(compute: Callable[[], Any], box: Path) -> Any:
    """Return what a function computes in a child, as JSON carries it.

    Raises:
        RuntimeError: the child ended without a result.
    """
    file = box / ".result"
    file.unlink(missing_ok=True)
    gc.freeze()
    child = os.fork()
    if child == 0:
        code = CRASHED
        try:
            silent = os.open(os.devnull, os.O_WRONLY)
            os.dup2(silent, 1)
            file.write_text(json.dumps(compute()))
            code = 0
        except BaseException:  # noqa: BLE001
            traceback.print_exc()
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    if status != 0:
        raise RuntimeError(f"a child ended with {os.waitstatus_to_exitcode(status)}")
    return json.loads(_taken(file))


def _taken(path: Path) -> str:
    if not path.exists():
        return ""
    text = path.read_text("utf-8", errors="replace")
    path.unlink()
    return text


def _child(
    words: Sequence[object] | Callable[[], Sequence[object]],
    box: Path,
    told: dict[str, Path],
    limits: Limits,
    before: Callable[[], None] | None,
) -> None:
    """Run the child process; never return."""
    code = CRASHED
    watch = _Watch(limits)
    try:
        os.chdir(box)
        for number, name in ((1, "out"), (2, "err")):
            file = os.open(told[name], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
            os.dup2(file, number)
            os.close(file)
        sys.stdout = io.TextIOWrapper(os.fdopen(1, "wb", closefd=False), "utf-8")
        sys.stderr = io.TextIOWrapper(
            os.fdopen(2, "wb", closefd=False), "utf-8", errors="backslashreplace"
        )
        sys.stdin = open(os.devnull)  # noqa: SIM115, PTH123
        signal.signal(signal.SIGINT, signal.default_int_handler)
        from clothtrack.cli import main

        if before is not None:
            before()
        said = [str(word) for word in (words() if callable(words) else words)]
        # Which modules are compiled first depends on what ran before, and is no work of the verb.
        sys.dont_write_bytecode = True
        _hold(limits)
        sys.addaudithook(watch)
        code = main(said)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:  # noqa: BLE001
        traceback.print_exc()
    finally:
        watch.asleep = True
        with suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        with suppress(OSError):
            told["changes"].write_text("\n".join([str(watch.count), *watch.outside]))
        os._exit(code)


def _hold(limits: Limits) -> None:
    """Set what the system enforces."""
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_MEMORY, used + MOST_MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (limits.cpu_s, limits.cpu_s + 1))
    if limits.file_bytes is not None:
        # Python ignores SIGXFSZ, so that the write is refused as on a full disk.
        resource.setrlimit(resource.RLIMIT_FSIZE, (limits.file_bytes, resource.RLIM_INFINITY))
    if limits.kill_cpu_s is not None:
        kill_after(limits.kill_cpu_s)


class _Watch:
    """Counts the changes of the file system, kills at one of them, and sees those outside."""

    def __init__(self, limits: Limits) -> None:
        self.count, self.asleep = 0, False
        self.outside: list[str] = []
        self._kill = limits.kill_change
        self._folder = None if limits.folder is None else str(limits.folder.resolve())

    def __call__(self, event: str, arguments: tuple) -> None:
        """See one event of Python's audit."""
        if self.asleep:
            return
        if event == "open":
            path, _, flags = arguments
            if not isinstance(flags, int) or not flags & _WRITING or isinstance(path, int):
                return
            self._change(path)
        elif event in _CHANGES:
            self._change(arguments[0])
            if event == "os.rename":
                self._seen(arguments[1])

    def _change(self, path: object) -> None:
        if self._kill is not None and self.count == self._kill:
            os.kill(os.getpid(), signal.SIGKILL)
        self.count += 1
        self._seen(path)

    def _seen(self, path: object) -> None:
        if self._folder is None or not isinstance(path, str | bytes | os.PathLike):
            return
        whole = os.path.realpath(os.fsdecode(path))
        allowed = (self._folder, "/dev", "/proc")
        if not any(whole == place or whole.startswith(place + os.sep) for place in allowed):
            self.outside.append(whole)


class _Event(ctypes.Structure):
    """`struct sigevent` of Linux."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("rest", ctypes.c_char * 48),
    )


class _Timer(ctypes.Structure):
    """`struct itimerspec`."""

    _fields_ = tuple((name, ctypes.c_long) for name in ("every_s", "every_ns", "s", "ns"))


def kill_after(cpu_s: float) -> None:
    """Have the system kill this process with SIGKILL after so much CPU time [s]."""
    library = ctypes.CDLL(None, use_errno=True)
    timer = ctypes.c_void_p()
    event = _Event(signal=signal.SIGKILL, notify=0)
    clock = time.CLOCK_PROCESS_CPUTIME_ID
    if library.timer_create(clock, ctypes.byref(event), ctypes.byref(timer)) != 0:
        raise OSError(ctypes.get_errno(), "timer_create")
    nanoseconds = max(int(1e9 * cpu_s), 1)
    when = _Timer(0, 0, nanoseconds // 10**9, nanoseconds % 10**9)
    if library.timer_settime(timer, 0, ctypes.byref(when), None) != 0:
        raise OSError(ctypes.get_errno(), "timer_settime")


def preload() -> None:
    """Import what the verbs need, once for all children."""
    import importlib

    from clothtrack.cli import command_line
    from clothtrack.geometry import quiet_warp

    quiet_warp()
    assert command_line.VERBS
    for name in (
        "cv2", "mujoco", "scipy.optimize", "torch", "torch._dynamo", "torch.utils.tensorboard",
        "zarr",
        "clothtrack.api.many", "clothtrack.api.look", "clothtrack.api.learning",
        "clothtrack_lab.many_episodes", "clothtrack_capture.importing.import_recording",
        "clothtrack_lab.graph_dynamics.roll_outs", "clothtrack.reconstruction.model_loading",
        "clothtrack.reconstruction.tokens.token_training", "clothtrack.report.page",
        "clothtrack_capture.segmentation_setup", "clothtrack.tracking.pipeline",
        "clothtrack_lab.world.bench_generation", "clothtrack_lab.world.filming",
    ):  # fmt: skip
        with suppress(ImportError):
            importlib.import_module(name)
