"""Stream that processes the newest picture and drops those it cannot process in time."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.live.growing_recording import Picker
from clothtrack.live.live_state import LiveState
from clothtrack.live.live_tracker import LiveTracker

STALL_S = 0.2
"""Time without data after which a camera or picker has stalled [s]."""


class LiveStream:
    """Stream that feeds a tracker from its own thread, through a queue of one picture.

    `put` returns at once. A waiting picture is dropped when a newer one arrives, and the next step
    follows the picker's path over the gap. Use it in a `with` block, or call `stop`.
    """

    def __init__(
        self, tracker: LiveTracker, on_state: Callable[[LiveState], None] | None = None
    ) -> None:
        """Start the thread."""
        self._tracker, self._on_state = tracker, on_state
        self._change = threading.Condition()
        self._waiting: tuple[float, tuple[Any, ...]] | None = None
        self._missed: list[tuple[float, Picker | None]] = []
        self._turns: list[Callable[[], None]] = []
        self._state: LiveState | None = None
        self._error: BaseException | None = None
        self._stopped = self._busy = False
        self._camera_s = time.monotonic()
        self._picker_s: dict[str, float] = {}
        self._stalled: tuple[str, ...] = ()
        self._thread = threading.Thread(target=self._serve, name="clothtrack-live", daemon=True)
        self._thread.start()

    def __enter__(self) -> "LiveStream":
        """Return the stream."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Stop; process the waiting picture unless the block raised."""
        if kind is None:
            self.stop()
        else:
            self._halt(serve=False)

    @property
    def state(self) -> LiveState | None:
        """Newest state; None before the first picture was processed."""
        return self._state

    def put(
        self,
        time_s: float,
        depth: np.ndarray,
        color: np.ndarray | None = None,
        mask: np.ndarray | None = None,
        picker: Picker | None = None,
    ) -> None:
        """Queue a picture, as in `LiveTracker.update`; arrays may be reused afterwards.

        Raises:
            Exception: processing an earlier picture failed.
        """
        now_s = time.monotonic()
        copies = [None if one is None else np.array(one) for one in (depth, color, mask)]
        with self._change:
            self._raise_if_over()
            if self._waiting is not None:
                _, (missed_s, *_, missed_picker) = self._waiting
                self._missed.append((missed_s, missed_picker))
            self._waiting, self._camera_s = (now_s, (time_s, *copies, picker)), now_s
            self._picker_s |= dict.fromkeys(picker or {}, now_s)
            self._change.notify_all()

    def begin_action(self) -> None:
        """Begin an action with the next processed picture."""
        with self._change:
            self._turns.append(self._tracker.begin_action)

    def end_action(self) -> None:
        """End the current action with the next processed picture."""
        with self._change:
            self._turns.append(self._tracker.end_action)

    def wait(self) -> None:
        """Wait until no picture is queued or being processed.

        Raises:
            Exception: processing a picture failed.
        """
        with self._change:
            while (self._waiting is not None or self._busy) and self._error is None:
                self._change.wait(timeout=0.05)
            if self._error is not None:
                raise self._error

    def stop(self) -> LiveState | None:
        """Process the waiting picture, end the thread, and return the last state.

        Raises:
            Exception: processing a picture failed.
        """
        self._halt(serve=True)
        if self._error is not None:
            raise self._error
        return self._state

    def _halt(self, *, serve: bool) -> None:
        with self._change:
            self._stopped = True
            if not serve:
                self._waiting = None
            self._change.notify_all()
        self._thread.join()

    def _raise_if_over(self) -> None:
        if self._error is not None:
            raise self._error
        if self._stopped:
            raise InvalidConfigError("the stream has stopped; make another one")

    def _serve(self) -> None:
        try:
            while self._serve_next():
                pass
        except BaseException as error:  # noqa: BLE001
            # `put`, `wait` and `stop` raise it in the caller's thread.
            self._error = error

    def _serve_next(self) -> bool:
        """Process one picture, or report stalled sources; return whether to continue."""
        with self._change:
            if self._waiting is None and not self._stopped:
                self._change.wait(timeout=0.25 * STALL_S)
            arrival, self._waiting = self._waiting, None
            missed, self._missed = self._missed, []
            turns, self._turns = (self._turns, []) if arrival else ([], self._turns)
            stopped, stalled = self._stopped, self._find_stalled()
            self._busy = arrival is not None
        for time_s, picker in missed:
            self._tracker.drop(time_s, picker)
        for turn in turns:
            turn()
        if arrival is not None:
            came_s, picture = arrival
            state = self._tracker.update(*picture)
            self._tell(replace(state, latency_s=time.monotonic() - came_s), stalled)
            with self._change:
                self._busy = False
                self._change.notify_all()
        elif self._state is not None and stalled != self._stalled:
            self._tell(self._state, stalled)
        return arrival is not None or not stopped

    def _find_stalled(self) -> tuple[str, ...]:
        """Return the sources that have stalled."""
        since_s = {"camera": self._camera_s, **self._picker_s}
        late_s = time.monotonic() - STALL_S
        return tuple(name for name, seen_s in since_s.items() if seen_s < late_s)

    def _tell(self, state: LiveState, stalled: tuple[str, ...]) -> None:
        self._stalled = stalled
        self._state = replace(state, stalled=stalled)
        if self._on_state is not None:
            self._on_state(self._state)
