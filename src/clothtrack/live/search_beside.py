"""Search of each ended action, in parallel with the stream.

Searches run one after the other, in a separate process (`search_process`). The process may be one
or more actions behind. It then continues from its own last result, and its results replace the live
track, as if every action had been searched immediately.
"""

import os
import pickle
import queue
import subprocess
import sys
import threading
import weakref
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clothtrack.live import search_process
from clothtrack.live.search_process import Answer, Question, Setup
from clothtrack.live.seen_log import SeenLog
from clothtrack.tracking.protocols import TrackedCandidate
from clothtrack.tracking.tracked_trajectory import StepRecords

MOST_WAITING = 4
"""Largest number of actions that wait while another is searched. An action that ends while the
queue is full is not searched, and the next one starts from its live track."""


@dataclass(frozen=True, eq=False)
class Asked:
    """Search request of an action.

    Attributes:
        number: number of the action among the stored ones.
        question: the question without its clouds, which are in `log`.
    """

    number: int
    frames: tuple[int, ...]
    question: Question
    log: SeenLog


def in_tracked_frames(known: TrackedCandidate, frames: Sequence[int]) -> TrackedCandidate:
    """Convert a live candidate to the frame numbers of its `Question`."""
    rows = np.array(frames)
    records = StepRecords.empty(len(rows))
    for name in StepRecords.__annotations__:
        getattr(records, name)[:] = getattr(known.records, name)[rows]
    action = replace(known.action, first_frame=0, last_frame=len(rows) - 1)
    positions = known.positions[rows[1:] - rows[0] - 1]
    return replace(known, action=action, positions=positions, records=records)


def in_live_frames(answer: Answer, frames: Sequence[int], count: int) -> TrackedCandidate:
    """Convert the chosen candidate to the live frames; it rests in untracked frames."""
    best, rows = answer.best, np.array(frames)
    records = StepRecords.empty(count)
    for name in StepRecords.__annotations__:
        getattr(records, name)[rows] = getattr(best.records, name)
    tracked = np.concatenate([answer.began_at[None].astype(np.float32), best.positions])
    every = np.arange(rows[0] + 1, rows[-1] + 1)
    positions = tracked[np.searchsorted(rows, every, side="right") - 1]
    action = replace(best.action, first_frame=int(rows[0]), last_frame=int(rows[-1]))
    return replace(best, action=action, positions=positions, records=records)


class SearchBeside:
    """Client of the search process."""

    def __init__(self, setup: Setup) -> None:
        """Start the process; earlier requests wait until it is ready."""
        self._waiting = deque[Asked]()
        self._questions: queue.SimpleQueue[Asked | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[Answer | str] = queue.SimpleQueue()
        self._lost = ""
        processes: list[subprocess.Popen[bytes]] = []
        self._end = weakref.finalize(self, _end, self._questions, processes)
        # The kernel ends a process with the thread that started it, which must not be the stream's.
        threading.Thread(
            target=_ask_all, args=(setup, self._questions, self._answers, processes),
            name="clothtrack-search", daemon=True,
        ).start()  # fmt: skip

    @property
    def busy(self) -> bool:
        """Whether an action is waiting for its search or being searched."""
        return bool(self._waiting)

    @property
    def full(self) -> bool:
        """Whether no further action can be searched."""
        return bool(self._lost) or len(self._waiting) > MOST_WAITING

    def ask(self, asked: Asked) -> None:
        """Queue an action for its search."""
        self._waiting.append(asked)
        self._questions.put(asked)

    def answers(self, *, wait: bool) -> Iterator[tuple[Asked, Answer | str]]:
        """Yield the new answers in the order of the actions."""
        while self._waiting:
            answer: Answer | str = self._lost
            if not answer:
                try:
                    answer = self._answers.get(block=wait)
                except queue.Empty:
                    return
                except KeyboardInterrupt:
                    if not wait:
                        raise
                    answer = "interrupted"
            if isinstance(answer, str):
                self._lost = answer
            yield self._waiting.popleft(), answer

    def close(self) -> None:
        """End the process without waiting for a running search."""
        self._end()


def _ask_all(
    setup: Setup,
    questions: queue.SimpleQueue[Asked | None],
    answers: queue.SimpleQueue[Answer | str],
    processes: list[subprocess.Popen[bytes]],
) -> None:
    """Send questions to the process, one at a time, until None; runs in a thread."""
    try:
        path = os.pathsep.join(each for each in sys.path if each)
        process = subprocess.Popen(
            [sys.executable, "-c", f"from {search_process.__name__} import main; main()"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=os.environ | {"PYTHONPATH": path},
        )  # fmt: skip
        processes.append(process)
        with process:
            given, taken = process.stdin, process.stdout
            assert given is not None
            assert taken is not None
            pickle.dump(setup, given, pickle.HIGHEST_PROTOCOL)
            for asked in iter(questions.get, None):
                question = replace(asked.question, seen=asked.log.packed())
                pickle.dump(question, given, pickle.HIGHEST_PROTOCOL)
                given.flush()
                answers.put(pickle.load(taken))
            process.kill()
    except Exception as error:  # noqa: BLE001
        # The tracker continues without searches after any error. A process may be killed if memory
        # is short, and only this thread can report that no answer comes.
        answers.put(f"the process that searches has ended: {str(error) or 'it died'}")


def _end(
    questions: queue.SimpleQueue[Asked | None], processes: list[subprocess.Popen[bytes]]
) -> None:
    questions.put(None)
    for process in processes:
        process.kill()
