"""The search of each action, beside the stream: asked when it has ended, answered when it is ready.

Searches are made one after the other, in a process of their own (`search_process`). It may be an
action or more behind: then it goes on from what it has found, and what was tracked live meanwhile
is replaced by what it finds, as if all had been searched at once.
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
"""Actions that wait for their search while another one is searched; one that ends while so many
wait is not searched, and the next one begins where it was tracked to."""


@dataclass(frozen=True, eq=False)
class Asked:
    """An action whose search was asked for.

    Attributes:
        number: of the action among those that are kept.
        frames: those that it was tracked through.
        question: without its clouds, which are in `log`.
        log: what was seen.
    """

    number: int
    frames: tuple[int, ...]
    question: Question
    log: SeenLog


def in_tracked_frames(known: TrackedCandidate, frames: Sequence[int]) -> TrackedCandidate:
    """Return a candidate that was tracked live in the frames of its `Question`.

    Args:
        known: in the frames of the live recording.
        frames: those that it was tracked through, from the first one of its action on.
    """
    rows = np.array(frames)
    records = StepRecords.empty(len(rows))
    for name in StepRecords.__annotations__:
        getattr(records, name)[:] = getattr(known.records, name)[rows]
    action = replace(known.action, first_frame=0, last_frame=len(rows) - 1)
    positions = known.positions[rows[1:] - rows[0] - 1]
    return replace(known, action=action, positions=positions, records=records)


def in_live_frames(answer: Answer, frames: Sequence[int], count: int) -> TrackedCandidate:
    """Return the chosen candidate in the frames of the live recording; it rests in those between.

    Args:
        answer: of a search.
        frames: those that the action was tracked through.
        count: of all frames of the recording.
    """
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
    """Asks the process that searches, and takes its answers."""

    def __init__(self, setup: Setup) -> None:
        """Start the process; what is asked before it is ready waits."""
        self._waiting = deque[Asked]()
        self._questions: queue.SimpleQueue[Asked | None] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[Answer | str] = queue.SimpleQueue()
        self._lost = ""
        processes: list[subprocess.Popen[bytes]] = []
        self._end = weakref.finalize(self, _end, self._questions, processes)
        # The kernel ends a process with the thread that started it: not with that of a stream.
        threading.Thread(
            target=_ask_all, args=(setup, self._questions, self._answers, processes),
            name="clothtrack-search", daemon=True,
        ).start()  # fmt: skip

    @property
    def busy(self) -> bool:
        """Whether an action waits for its search, or is being searched."""
        return bool(self._waiting)

    @property
    def full(self) -> bool:
        """Whether no other action can be searched."""
        return bool(self._lost) or len(self._waiting) > MOST_WAITING

    def ask(self, asked: Asked) -> None:
        """Have an action searched, after those that wait."""
        self._waiting.append(asked)
        self._questions.put(asked)

    def answers(self, *, wait: bool) -> Iterator[tuple[Asked, Answer | str]]:
        """Yield what has been answered since, in the order of the actions.

        Args:
            wait: until nothing waits.

        Yields:
            The action, and what was found or why nothing was.
        """
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
        """End the process; an answer that is still made is not waited for."""
        self._end()


def _ask_all(
    setup: Setup,
    questions: queue.SimpleQueue[Asked | None],
    answers: queue.SimpleQueue[Answer | str],
    processes: list[subprocess.Popen[bytes]],
) -> None:
    """Hand questions over, one at a time, until there is None; in a thread."""
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
        # The tracker goes on without, whatever it was: a process may be killed where memory is
        # short, and nobody else would tell that no answer comes.
        answers.put(f"the process that searches has ended: {str(error) or 'it died'}")


def _end(
    questions: queue.SimpleQueue[Asked | None], processes: list[subprocess.Popen[bytes]]
) -> None:
    questions.put(None)
    for process in processes:
        process.kill()
