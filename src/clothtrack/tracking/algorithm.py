"""Algorithm 1 of the paper: the full mesh at every observation, from dynamics and point clouds.

Read it beside the paper (arXiv 2302.09502, Sec. III-B). Every function is handed in as part of a
`Method` (`tracking/protocols.py`). An ablation is another function in its place.

    paper                          here
    x_t                            state
    theta                          theta: stiffness and frictions of the cloth
    a_t                            picker_action
    x'_{t+1} = dyn(x_t, a_t)       predicted
    delta x_corr                   correction (TTO1)
    a~_t                           the correction as pseudo-action, made by line_search
    TTO2                           align_last

Nothing here can see the truth: the inputs are a recording and the cloth at its first frame.
"""

from itertools import pairwise

from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import PickAndPlace, Recording
from clothtrack.simulation.picker_action import PickerAction
from clothtrack.tracking.protocols import (
    Candidate,
    Corrected,
    Correction,
    Dynamics,
    Method,
    State,
    TrackedCandidate,
)
from clothtrack.tracking.recorder import Recorder
from clothtrack.tracking.theta import Theta


def track(
    recording: Recording, state: State, theta: Theta, method: Method, recorder: Recorder
) -> None:
    """Track the cloth through every action of a recording.

    Args:
        recording: frames, pick-and-places and the paths of the pickers.
        state: the cloth at the first frame.
        theta: its parameters before any calibration.
        method: the functions that the algorithm is made of.
        recorder: keeps the chosen candidate of each action.
    """
    for action in recording.actions:  # Algorithm 1, line 2
        first, last = recording.frames[action.first_frame], recording.frames[action.last_frame]
        method.anchor(state, method.observe(first))  # not in the paper
        search = method.calibrate(action, state, theta)
        for candidate in search:  # Sec. III-B.1; the paper's yields one
            search.tell(
                track_action(recording, action, state, candidate, method=method, recorder=recorder)
            )
        best, state, calibration = search.result()
        theta, held = best.candidate.theta, best.candidate.grasps.closed_at(last.time_s)
        state, losses = method.align_last(state, theta, method.observe(last), held)  # TTO2
        recorder.keep(best, state, losses, calibration)


def track_action(
    recording: Recording,
    action: PickAndPlace,
    state: State,
    candidate: Candidate,
    *,
    method: Method,
    recorder: Recorder,
) -> TrackedCandidate:
    """Track one pick-and-place to its last frame with one candidate: lines 4 to 8.

    Args:
        recording: frames with their times.
        action: the pick-and-place.
        state: the cloth at its first frame.
        candidate: the cloth's parameters, and what the pickers hold.
        method: the functions that the algorithm is made of.
        recorder: notes what happens at every frame.
    """
    notes, dyn = recorder.begin(action, candidate), method.dynamics(candidate.theta)
    tracked_at = recording.frames[action.first_frame]  # where the state was last moved
    for before, frame in pairwise(recording.frames[action.first_frame : action.last_frame + 1]):
        picker_action = candidate.grasps.action(before.time_s, frame.time_s)
        if method.at_rest(picker_action, tracked_at, frame):  # not in the paper
            notes.rest(frame, state)
            continue
        corrected, correction = _track_frame(
            dyn, state, picker_action, method.observe(frame), method
        )
        notes.step(frame, correction, corrected)
        state, tracked_at = corrected.state, frame
    return notes.finished(state)


def _track_frame(
    dyn: Dynamics, state: State, picker_action: PickerAction, seen: Observation, method: Method
) -> tuple[Corrected, Correction | None]:
    """Track the cloth from one frame to the next.

    Args:
        dyn: the dynamics with the candidate's parameters.
        state: the cloth before, x_t.
        picker_action: what the pickers do in between, a_t.
        seen: the cloud after, P_{t+1}.
        method: TTO1 and the line search.
    """
    predicted = dyn.predict(state, picker_action)  # x'_{t+1} = dyn(x_t, a_t)
    correction = method.align(predicted, seen)  # TTO1, Sec. III-B.2
    # x_{t+1} = dyn(x_t, a_t, a~_t), Sec. III-B.3
    return method.line_search(dyn, state, picker_action, predicted, correction), correction
