"""Worker processes: how many, how they start, and that they end when their parent is stopped."""

import signal
import time
from multiprocessing import active_children

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.devices import quiet_warp

PATIENCE_S = 10.0
"""How long workers may take to clear away what is half-written before they are killed [s]."""

_ASK_AGAIN_S = 0.5


def require_workers(number: int) -> None:
    """Refuse a number of worker processes that cannot be.

    Raises:
        InvalidConfigError: with the number.
    """
    if number < 1:
        raise InvalidConfigError(f"the number of workers is {number}; give at least 1")


def start_worker() -> None:
    """A worker is silent; an interrupt from the keyboard is for its parent to handle."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    quiet_warp()


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
