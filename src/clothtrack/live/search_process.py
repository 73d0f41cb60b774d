"""The search process, which follows a live tracker one or more actions behind.

It runs Algorithm 1 as `track` does, with the configured search, on the tracker's observations. It
reuses the candidate that was tracked live. It reads a `Setup` and then `Question`s from standard
input, and answers each on standard output; all are pickled. Both pipes, and the unnamed file of
clouds (`seen_log`), belong only to the tracker's process and this one. Therefore nothing is
unpickled that anyone else could have written.

It does not use `multiprocessing`, which imports the caller's program again: a program that tracks
at module level would then track in every process.
"""

import os
import pickle
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import BinaryIO

import numpy as np
from jaxtyping import Float

from clothtrack.errors import ClothTrackError
from clothtrack.files.worker_pool import start_worker
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.live.seen_log import unpacked
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, PickAndPlace, PickerPath, Recording
from clothtrack.simulation.picker_action import PickerAction
from clothtrack.tracking.algorithm import aligned_end, begin_action, track_action
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.methods import METHODS, Components
from clothtrack.tracking.protocols import Candidate, State, TrackedCandidate
from clothtrack.tracking.recorder import Recorder
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.tracked_trajectory import Calibration

NICE = 10
"""Niceness of the process, so that new pictures have priority on a single core."""


@dataclass(frozen=True, eq=False)
class Setup:
    """Data from which the method is created.

    Attributes:
        recording: cameras, table and cloth, with the first frame.
        mesh: the flat cloth in the world [m].
        start: vertices at the first frame [m]; None if the cloth lies flat there.
    """

    recording: Recording
    mesh: ClothMesh
    config: RunConfig
    start: Float[np.ndarray, "vertices 3"] | None
    seen: Observation
    device: str


@dataclass(frozen=True, eq=False)
class Standing:
    """Start of an action."""

    state: State
    theta: Theta
    bound: Mapping[int, tuple[int, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Question:
    """Ended action to search. Its frames are the tracked ones, numbered from 0.

    Attributes:
        times_s: times of the frames [s].
        rests: whether the pictures did not change, per frame.
        pickers: names of the pickers of the action.
        start: start of the action; None: the end of the last answer.
        known: candidate that was tracked live from this start; None if there is none.
    """

    times_s: tuple[float, ...]
    rests: tuple[bool, ...]
    seen: bytes
    pickers: tuple[str, ...]
    paths: Mapping[str, PickerPath]
    start: Standing | None
    known: TrackedCandidate | None


@dataclass(frozen=True, eq=False)
class Answer:
    """Result of a search.

    Attributes:
        losses: objective [m^2] before and after the final alignment.
        began_at: vertices at the beginning of the action [m].
    """

    best: TrackedCandidate
    end: Standing
    losses: tuple[float, float]
    calibration: Calibration
    began_at: Float[np.ndarray, "vertices 3"]


class Searcher:
    """Search of one action after the other."""

    def __init__(self, setup: Setup) -> None:
        """Create the method on a recording that contains one action at a time."""
        self._frames = list(setup.recording.frames)
        self._actions: list[PickAndPlace] = []
        self._paths: dict[str, PickerPath] = {}
        self._seen, self._rests = [setup.seen], [False]
        self._recording = replace(
            setup.recording, frames=self._frames, actions=self._actions, picker_paths=self._paths
        )
        self._components = Components(
            self._recording, setup.mesh, setup.config, self._observe, setup.start, setup.device
        )
        made = METHODS[setup.config.mode](self._components)
        self._method = replace(made.method, at_rest=self._at_rest)
        self._standing = Standing(made.state, made.theta, {})

    def __call__(self, question: Question) -> Answer:
        """Return the best candidate for an action, as `tracking.algorithm.track` finds it."""
        action, start = self._show(question), question.start or self._standing
        anchors, recording = self._components.anchors, self._recording
        anchors.bound = dict(start.bound)
        recorder = Recorder(
            recording, self._components.mesh, start.state, self._components.visible
        )  # fmt: skip
        method = recorder.timed(self._method)
        begin_action(self._frames[0], start.state, method)
        search = method.calibrate(action, start.state, start.theta)
        for candidate in search:
            known = question.known
            if known is None or not _same(candidate, known.candidate):
                known = track_action(
                    recording, action, start.state, candidate, method=method, recorder=recorder
                )
            search.tell(known)
        best, state, calibration = search.result()
        state, losses = aligned_end(recording, best, state, method)
        self._standing = Standing(state, best.candidate.theta, dict(anchors.bound))
        return Answer(best, self._standing, losses, calibration, start.state.positions[0])

    def _show(self, question: Question) -> PickAndPlace:
        """Replace the frames of the last action with those of this one."""
        action = PickAndPlace(0, len(question.times_s) - 1, question.pickers)
        self._frames[:] = [Frame(index, time_s) for index, time_s in enumerate(question.times_s)]
        self._actions[:] = [action]
        self._paths.clear()
        self._paths.update(question.paths)
        self._seen, self._rests = unpacked(question.seen), list(question.rests)
        return action

    def _observe(self, frame: Frame) -> Observation:
        return self._seen[frame.index]

    def _at_rest(self, action: PickerAction, tracked_at: Frame, frame: Frame) -> bool:  # noqa: ARG002
        """Return the live result, since pictures are missing here and equal for all candidates."""
        return action.motion is None and self._rests[frame.index]


def _same(candidate: Candidate, known: Candidate) -> bool:
    """Return whether two candidates hold the same vertices of the same cloth."""
    here, there = (one.grasps.identity(one.theta) for one in (candidate, known))
    return here == there


def serve(questions: BinaryIO, answers: BinaryIO) -> None:
    """Answer questions until the input ends or one fails, which is answered by its error."""
    searcher = Searcher(pickle.load(questions))
    while True:
        try:
            question = pickle.load(questions)
        except EOFError:
            return
        try:
            answer: Answer | str = searcher(question)
        except ClothTrackError as error:
            answer = str(error)
        pickle.dump(answer, answers, pickle.HIGHEST_PROTOCOL)
        answers.flush()
        if isinstance(answer, str):
            return


def main() -> None:
    """Run the search process on standard input and output."""
    start_worker()
    os.nice(NICE)
    # Redirect standard output so that text printed by libraries does not mix with the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    serve(sys.stdin.buffer, answers)
