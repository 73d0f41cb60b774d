"""The process that searches: it follows a live tracker, an action or more behind.

It runs Algorithm 1 as `track` does, with the search of the configuration, on what the tracker has
seen. The candidate that was tracked live counts as tracked. What it reads from its standard input
are a `Setup` and then `Question`s, and it answers each on its standard output; all are pickled.
Both pipes, and the file without a name that clouds come from (`seen_log`), are of the tracker's own
process and this one: nothing is unpickled that anyone else could have written.

It is no child of `multiprocessing`: that imports the caller's program once more, and a program that
tracks in its first lines would track in every process.
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
"""Pictures that come are served first where there is one core."""


@dataclass(frozen=True, eq=False)
class Setup:
    """What the method is made of.

    Attributes:
        recording: cameras, table and cloth, with the first frame.
        mesh: the flat cloth in the world [m].
        config: the settings.
        start: vertices at the first frame [m], if the cloth does not lie flat there.
        seen: the cloud of the first frame.
        device: "cpu" or "cuda:0".
    """

    recording: Recording
    mesh: ClothMesh
    config: RunConfig
    start: Float[np.ndarray, "vertices 3"] | None
    seen: Observation
    device: str


@dataclass(frozen=True, eq=False)
class Standing:
    """All that an action starts from.

    Attributes:
        state: the cloth.
        theta: its parameters.
        bound: the points that are followed (`FeatureAnchors`).
    """

    state: State
    theta: Theta
    bound: Mapping[int, tuple[int, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Question:
    """An action that has ended. Its frames count from 0, and are those that were tracked.

    Attributes:
        times_s: of the frames [s].
        rests: in which of them the pictures did not change.
        seen: their clouds, packed (`SeenLog`).
        pickers: by whom the action is.
        paths: of all pickers.
        start: what it starts from; None: what the last answer ended with.
        known: the candidate that was tracked live from there; None where none was.
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
    """What came of a search.

    Attributes:
        best: the candidate that was chosen.
        end: what the next action starts from.
        losses: objective [m^2] before and after the final alignment.
        calibration: the record of the search.
        began_at: vertices where the action began [m].
    """

    best: TrackedCandidate
    end: Standing
    losses: tuple[float, float]
    calibration: Calibration
    began_at: Float[np.ndarray, "vertices 3"]


class Searcher:
    """Searches one action after the other."""

    def __init__(self, setup: Setup) -> None:
        """Make the method, on a recording of which one action is shown at a time."""
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
        """Put the frames of an action in the place of those of the last one."""
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
        """Return what was found live: pictures are not here, and they are the same for all."""
        return action.motion is None and self._rests[frame.index]


def _same(candidate: Candidate, known: Candidate) -> bool:
    """Return whether two candidates hold the same vertices of the same cloth."""
    here, there = (one.grasps.identity(one.theta) for one in (candidate, known))
    return here == there


def serve(questions: BinaryIO, answers: BinaryIO) -> None:
    """Answer questions until there are no more, or one cannot be: that is answered in words."""
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
    """Serve whoever started this process."""
    start_worker()
    os.nice(NICE)
    # What a library prints must not be among the answers.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    serve(sys.stdin.buffer, answers)
