"""Checks of the picker against the cloth: it must close on cloth, and carry cloth."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.distance import cdist

from clothtrack.recordings.geometry_checks.finding import Finding, ObservedFrames, reaches_rim
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import PickAndPlace, Recording

REACH_M = 0.03
"""A tip that closes farther from the cloth than this [m] holds nothing (`tracking.picking`). On
right recordings it closes within 9 mm, or within 22 mm if depth is missing there."""

_FARTHEST_CARRIED_M = 0.016
"""Distance of a closed tip from the cloth [m] that a quarter of its frames may exceed; beyond that,
the tip is not where the cloth is carried."""

_HIDDEN_M = 0.05
"""A tip behind a tool or hand, where nothing can be measured, may have unseen cloth beside it. An
arm and hand that reach over the cloth hide everything nearer than this [m]."""

_CARRIED_FRAMES = 12
"""Number of frames of each action that are checked while its picker is closed."""


@dataclass(frozen=True)
class _Hold:
    """One picker in one action.

    Attributes:
        closed: the frames of the action in which it is closed.
    """

    action: int
    name: str
    closed: tuple[int, ...]


def picker_findings(recording: Recording, frames: ObservedFrames) -> list[Finding]:
    """Return actions whose picker never closes, closes beside the cloth, or carries none."""
    findings = []
    for number, action in enumerate(recording.actions):
        for hold in _holds(recording, number, action):
            found = _never_closed(hold) or _closes_beside(recording, hold, frames)
            found = found or _carries_none(recording, hold, frames)
            findings += [found] if found else []
    return findings


def held_by_name(recording: Recording, picker: str) -> bool:
    """Return whether the recording says what the picker holds; its tip need not be there then."""
    return picker in recording.cloth.held_vertices


def allowance_m(recording: Recording) -> float:
    """Return the additional distance that a right tip may have from the cloth's points [m]."""
    cut_away_m = recording.observed.tool_clearance_m
    return cut_away_m + recording.cloth.grasp_uncertainty_m


def _holds(recording: Recording, number: int, action: PickAndPlace) -> Iterator[_Hold]:
    for name in action.pickers:
        if held_by_name(recording, name):
            continue
        path = recording.picker_paths[name]
        span = range(action.first_frame, action.last_frame + 1)
        closed = tuple(i for i in span if path.closed_at(recording.frames[i].time_s))
        yield _Hold(number, name, closed)


def carried_frames(recording: Recording, number: int, picker: str) -> tuple[int, ...]:
    """Return up to twelve frames of an action in which a picker is closed, spread evenly."""
    for hold in _holds(recording, number, recording.actions[number]):
        if hold.name == picker and hold.closed:
            return _spread(hold)
    return ()


def _spread(hold: _Hold) -> tuple[int, ...]:
    chosen = np.linspace(0, len(hold.closed) - 1, _CARRIED_FRAMES).round().astype(int)
    return tuple(hold.closed[place] for place in np.unique(chosen))


def _never_closed(hold: _Hold) -> Finding | None:
    if hold.closed:
        return None
    return Finding(
        "picker_path", 0.0, 1.0, "", "picker.csv: closed",
        f"picker {hold.name!r} is closed in no frame of action {hold.action + 1}: correct closed "
        "of picker.csv (1 while it holds cloth), or the frames of the action",
    )  # fmt: skip


def _closes_beside(recording: Recording, hold: _Hold, frames: ObservedFrames) -> Finding | None:
    """Return a finding if the closing tip is away from the cloth, then and when the action starts.

    The second covers cloth that is hidden when the picker closes.
    """
    first = recording.actions[hold.action].first_frame
    time_s = recording.frames[hold.closed[0]].time_s
    tip = recording.picker_paths[hold.name].position_at(time_s)
    gaps = [
        _gap_m(seen, tip)
        for seen in (frames.at(frame) for frame in (first, hold.closed[0]))
        if seen is not None and not _beyond(seen, tip)
    ]
    gap_m, limit_m = float(np.nanmin([*gaps, np.inf])), REACH_M + allowance_m(recording)
    if not np.isfinite(gap_m) or gap_m <= limit_m:
        return None
    return Finding(
        "picker_path", gap_m, limit_m, "m", "picker.csv: x_m, y_m, z_m",
        f"picker {hold.name!r} closes {1e3 * gap_m:.0f} mm from the cloth at {time_s:g} s, in "
        f"action {hold.action + 1} (at most {1e3 * limit_m:.0f}): write x_m, y_m, z_m of "
        "picker.csv in the world of the cameras, and closed as 1 while it holds cloth",
    )  # fmt: skip


def _carries_none(recording: Recording, hold: _Hold, frames: ObservedFrames) -> Finding | None:
    """Return a finding if the closed tip is away from the cloth of the same frames."""
    path = recording.picker_paths[hold.name]
    gaps = [
        carried_distances_m(seen, tip[None], allowance_m(recording))[0]
        for frame in _spread(hold)
        for tip in [path.position_at(recording.frames[frame].time_s)]
        if (seen := frames.at(frame)) is not None and len(seen.points) and not _beyond(seen, tip)
    ]
    gap_m, limit_m = float(np.percentile(gaps, 75)) if gaps else 0.0, _FARTHEST_CARRIED_M
    if gap_m <= limit_m:
        return None
    return Finding(
        "picker_path", gap_m, limit_m, "m", "picker.csv: x_m, y_m, z_m",
        f"no cloth is where picker {hold.name!r} carries it in action {hold.action + 1}, the "
        f"nearest is {1e3 * gap_m:.0f} mm away (at most {1e3 * limit_m:.0f}): write x_m, y_m, z_m "
        "of picker.csv in the world of the cameras, and time_s by their clock",
    )  # fmt: skip


def carried_distances_m(
    seen: Observation, tips: Float[np.ndarray, "tips 3"], allowance_m: float
) -> Float[np.ndarray, " tips"]:
    """Return the distances of tips from the cloth of a frame [m], less margins for unseen cloth."""
    gaps = _distances_m(seen, tips) - allowance_m
    return np.maximum(gaps - _HIDDEN_M * _hidden(seen, tips), 0.0)


def _hidden(seen: Observation, tips: Float[np.ndarray, "tips 3"]) -> Bool[np.ndarray, " tips"]:
    """Return which tips are in some picture, and on a hidden pixel in all that they are in."""
    inside, clear = np.zeros((2, len(tips)), dtype=bool)
    for camera in seen.cameras:
        pixels, depth = camera.project(tips)
        columns, rows = np.rint(np.nan_to_num(pixels, nan=-1.0)).T
        here = (depth > 0) & (columns >= 0) & (columns < camera.width)
        here &= (rows >= 0) & (rows < camera.height)
        inside |= here
        picture = seen.hidden.get(camera.name)
        if picture is None:
            clear |= here
        else:
            places = rows[here].astype(np.int64), columns[here].astype(np.int64)
            clear[here] |= ~picture[places]
    return inside & ~clear


def _beyond(seen: Observation, tip: Float[np.ndarray, " 3"]) -> bool:
    """Return whether a tip outside the pictures may be at cloth that goes on beyond them."""
    for camera in seen.cameras:
        (pixel,), (depth,) = camera.project(tip[None])
        if depth > 0 and (pixel >= 0).all() and (pixel < (camera.width, camera.height)).all():
            return False
    return len(seen.points) > 0 and reaches_rim(seen)


def _gap_m(seen: Observation, tip: Float[np.ndarray, " 3"]) -> float:
    """Return the distance of a tip from the nearest point of the cloth [m]; NaN if none is seen."""
    if not len(seen.points):
        return float("nan")
    return float(_distances_m(seen, tip[None])[0])


def _distances_m(
    seen: Observation, tips: Float[np.ndarray, "tips 3"]
) -> Float[np.ndarray, " tips"]:
    """Return the distances of tips from the nearest point of the cloth [m].

    This is for few tips: building a tree of the points takes longer than trying all.
    """
    return cdist(tips, seen.points).min(axis=1)
