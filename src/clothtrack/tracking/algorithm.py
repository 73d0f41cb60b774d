"""Algorithm 1 of the paper: the full mesh at every observation, from dynamics and cloud together.

Read it with the paper open (arXiv 2302.09502, Sec. III-B). Every part is handed in
(`tracking/seams.py`): an ablation is another function in its place, and nothing here asks which.

    paper                          here
    x_t                            state
    theta                          theta: stiffness and frictions of the cloth, by name
    a_t                            picker_action
    x'_{t+1} = dyn(x_t, a_t)       predicted
    delta x_corr                   correction (TTO1)
    a~_t                           the correction as pseudo-action, made by line_search
    TTO2                           align_last

Nothing here can see the truth: the inputs are a recording and the cloth at its first frame.
"""

from collections.abc import Callable
from itertools import pairwise

from clothtrack.recordings.recording import PickAndPlace, Recording
from clothtrack.tracking.recorder import Recorder
from clothtrack.tracking.seams import FollowedAction, Grasps, Parts, State, Theta


def track(
    recording: Recording, state: State, theta: Theta, parts: Parts, recorder: Recorder
) -> None:
    """Track the cloth through every action of a recording; the recorder keeps what comes of it.

    Args:
        recording: frames, pick-and-places and the paths of the pickers.
        state: the cloth at the first frame.
        theta: its parameters before any calibration.
        parts: the functions that the algorithm is made of.
        recorder: keeps the passes that are chosen; the other candidates leave nothing.
    """
    for action in recording.actions:  # Algorithm 1, line 2
        parts.mark(state, parts.observe(recording.frames[action.first_frame]))  # not in the paper
        follow_with = _each_once(recording, action, state, parts, recorder)
        theta, calibration = parts.calibrate(action, state, theta, follow_with)  # Sec. III-B.1
        followed = follow_with(theta)
        theta, last = followed.theta, recording.frames[action.last_frame]
        held = followed.grasps.closed_at(last.time_s)
        state = parts.combine(followed.state, theta, calibration)  # not in the paper
        state, losses = parts.align_last(state, theta, parts.observe(last), held)  # TTO2
        recorder.keep(followed, state, losses, calibration)


def follow(
    recording: Recording,
    action: PickAndPlace,
    state: State,
    theta: Theta,
    *,
    grasps: Grasps,
    parts: Parts,
    recorder: Recorder,
) -> FollowedAction:
    """Follow one pick-and-place to its last frame with one choice of parameters.

    Args:
        recording: frames with their times.
        action: the pick-and-place.
        state: the cloth at its first frame.
        theta: the cloth's parameters.
        grasps: what the pickers hold.
        parts: the functions that the algorithm is made of.
        recorder: notes what happens at every frame.
    """
    notes, parts = recorder.begin(action, parts)
    dyn = parts.dynamics(theta)
    predict, observe, align, line_search = (
        parts.predict, parts.observe, parts.align, parts.line_search,
    )  # fmt: skip
    frames = recording.frames[action.first_frame : action.last_frame + 1]
    for before, frame in pairwise(frames):
        picker_action = grasps.action(before.time_s, frame.time_s)
        predicted = predict(dyn, state, picker_action)  # x'_{t+1} = dyn(x_t, a_t)
        correction = align(predicted, observe(frame))  # TTO1, Sec. III-B.2
        corrected = line_search(dyn, state, picker_action, predicted, correction)  # Sec. III-B.3
        notes.step(frame, correction, corrected)
        state = corrected.state  # x_{t+1} = dyn(x_t, a_t, a~_t)
    return notes.finished(theta, grasps, state)


def _each_once(
    recording: Recording, action: PickAndPlace, state: State, parts: Parts, recorder: Recorder
) -> Callable[[Theta], FollowedAction]:
    """`follow` as a function of theta; candidates that come to the same pass share it."""
    passes: dict[tuple[object, ...], FollowedAction] = {}

    def follow_with(theta: Theta) -> FollowedAction:
        grasps = parts.pick(action, state, theta)
        key = grasps.identity(theta)
        if key not in passes:
            passes[key] = follow(
                recording, action, state, theta, grasps=grasps, parts=parts, recorder=recorder
            )
        return passes[key]

    return follow_with
