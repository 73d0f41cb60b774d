"""Algorithm 1 of the paper: the full mesh at every observation, from dynamics and point clouds.

Read it next to the paper (arXiv 2302.09502, Sec. III-B). Every function is passed in as part of a
`Method` (`tracking/protocols.py`). An ablation replaces one of them.

    paper                          here
    x_t                            state
    theta                          theta: stiffness and frictions of the cloth
    a_t                            picker_action
    x'_{t+1} = dyn(x_t, a_t)       predicted
    delta x_corr                   correction (TTO1)
    a~_t                           the correction as pseudo-action, made by line_search
    TTO2                           align_last

This code has no access to the ground truth: its inputs are a recording and the cloth at its first
frame. `clothtrack.live` calls the same steps while the recording grows.
"""

from dataclasses import dataclass

from clothtrack.recordings.recording import Frame, PickAndPlace, Recording
from clothtrack.simulation.picker_action import PickerAction
from clothtrack.tracking.protocols import (
    Candidate,
    Corrected,
    Correction,
    Dynamics,
    Grasps,
    Method,
    State,
    TrackedCandidate,
)
from clothtrack.tracking.recorder import CandidateNotes, Recorder
from clothtrack.tracking.theta import Theta
from clothtrack.tracking.tracked_trajectory import Calibration


@dataclass(frozen=True, eq=False)
class Tracked:
    """Tracking progress of an action.

    Attributes:
        moved_at: the frame into which the mesh was last moved.
    """

    state: State
    moved_at: Frame
    frame: Frame


def track(
    recording: Recording, state: State, theta: Theta, method: Method, recorder: Recorder
) -> None:
    """Track the cloth through every action of a recording."""
    for action in recording.actions:  # Algorithm 1, line 2
        begin_action(recording.frames[action.first_frame], state, method)
        search = method.calibrate(action, state, theta)
        for candidate in search:  # Sec. III-B.1; the paper's search yields one
            search.tell(
                track_action(recording, action, state, candidate, method=method, recorder=recorder)
            )
        theta, state = end_action(recording, *search.result(), method=method, recorder=recorder)


def begin_action(first: Frame, state: State, method: Method) -> None:
    """Bind feature tracks to the visible cloth at the start of an action."""
    method.anchor(state, method.observe(first))  # not in the paper


def end_action(
    recording: Recording,
    best: TrackedCandidate,
    state: State,
    calibration: Calibration,
    *,
    method: Method,
    recorder: Recorder,
) -> tuple[Theta, State]:
    """Align the cloth once more at the end of an action: line 9."""
    last = recording.frames[best.action.last_frame]
    held = best.candidate.grasps.closed_at(last.time_s)
    theta = best.candidate.theta
    state, losses = method.align_last(state, theta, method.observe(last), held)  # TTO2
    recorder.keep(best, state, losses, calibration)
    return theta, state


def track_action(
    recording: Recording,
    action: PickAndPlace,
    state: State,
    candidate: Candidate,
    *,
    method: Method,
    recorder: Recorder,
) -> TrackedCandidate:
    """Track one pick-and-place to its last frame with one candidate: lines 4 to 8."""
    notes, dyn = recorder.begin(action, candidate), method.dynamics(candidate.theta)
    first, *frames = recording.frames[action.first_frame : action.last_frame + 1]
    tracked = Tracked(state, first, first)
    for frame in frames:
        tracked = track_frame(dyn, tracked, candidate.grasps, frame, method=method, notes=notes)
    return notes.finished(tracked.state)


def track_frame(
    dyn: Dynamics,
    tracked: Tracked,
    grasps: Grasps,
    frame: Frame,
    *,
    method: Method,
    notes: CandidateNotes,
) -> Tracked:
    """Track the cloth into the next frame of an action, or leave it unchanged if it is at rest."""
    picker_action = grasps.action(tracked.frame.time_s, frame.time_s)
    if method.at_rest(picker_action, tracked.moved_at, frame):  # not in the paper
        notes.rest(frame, tracked.state)
        return Tracked(tracked.state, tracked.moved_at, frame)
    corrected, correction = _corrected(dyn, tracked.state, picker_action, frame, method)
    notes.step(frame, correction, corrected)
    return Tracked(corrected.state, frame, frame)


def _corrected(
    dyn: Dynamics, state: State, picker_action: PickerAction, frame: Frame, method: Method
) -> tuple[Corrected, Correction | None]:
    """Predict, align, and roll out with the correction."""
    predicted = dyn.predict(state, picker_action)  # x'_{t+1} = dyn(x_t, a_t)
    correction = method.align(predicted, method.observe(frame))  # TTO1, Sec. III-B.2
    # x_{t+1} = dyn(x_t, a_t, a~_t), Sec. III-B.3
    return method.line_search(dyn, state, picker_action, predicted, correction), correction
