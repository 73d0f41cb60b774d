"""Checks of the actions against the picker: they must contain its pick and its release."""

import numpy as np

from clothtrack.recordings.geometry_checks.finding import Finding
from clothtrack.recordings.geometry_checks.picker_checks import held_by_name
from clothtrack.recordings.recording import PickAndPlace, PickerPath, Recording

_LEAST_LATE_S = 0.1
_LEAST_LATE_M = 0.02
"""A pick or a release outside of its action counts if the closed tip moves at least so far there
[m], in at least so much time [s]."""


def action_findings(recording: Recording) -> list[Finding]:
    """Return actions that leave out the pick or the release."""
    found = []
    for number, action in enumerate(recording.actions):
        for name in action.pickers:
            if held_by_name(recording, name):
                continue
            found += _left_out(recording, number, name, recording.picker_paths[name])
    return found


def _left_out(recording: Recording, number: int, name: str, path: PickerPath) -> list[Finding]:
    """Return findings where the closed picker moves before the action begins or after it ends."""
    action, times = recording.actions[number], [frame.time_s for frame in recording.frames]
    begin_s, end_s = times[action.first_frame], times[action.last_frame]
    before = after = (begin_s, begin_s)
    if not _continued(recording, number - 1, name, action.first_frame):
        before = (max(_closed_since(path, begin_s), times[0]), begin_s)
    if not _continued(recording, number + 1, name, action.last_frame):
        after = (end_s, min(_closed_until(path, end_s), times[-1]))
    found = []
    for (first_s, last_s), kind, word, field, remedy in (
        (before, "action_begins_late", "before", "first_frame", "pick"),
        (after, "action_ends_early", "after", "last_frame", "release"),
    ):
        gone_m = _way_m(path, first_s, last_s)
        if last_s - first_s < _LEAST_LATE_S or gone_m < _LEAST_LATE_M:
            continue
        edge = action.first_frame if field == "first_frame" else action.last_frame
        found.append(
            Finding(
                kind, last_s - first_s, _LEAST_LATE_S, "s", f"actions[{number}].{field}",
                f"picker {name!r} is closed for {last_s - first_s:.2f} s and goes "
                f"{100 * gone_m:.0f} cm {word} frame {edge}, where action {number + 1} "
                f"{'begins' if field == 'first_frame' else 'ends'} (at most {_LEAST_LATE_S:g} s): "
                f"put the {remedy} inside the action, {field} "
                f"{_frame_beside(times, first_s if field == 'first_frame' else last_s, field)}",
            )
        )  # fmt: skip
    return found


def _frame_beside(times: list[float], time_s: float, field: str) -> int:
    """Return a frame before a time for `first_frame`, or a frame after it for `last_frame`."""
    place = int(np.searchsorted(times, time_s + 1e-9, side="right")) - 1
    return max(place - 1, 0) if field == "first_frame" else min(place + 1, len(times) - 1)


def _continued(recording: Recording, number: int, name: str, frame: int) -> bool:
    """Return whether another action of the picker continues where this one begins or ends."""
    if not 0 <= number < len(recording.actions):
        return False
    other: PickAndPlace = recording.actions[number]
    near = min(abs(other.first_frame - frame), abs(other.last_frame - frame)) <= 2
    return near and name in other.pickers


def _closed_since(path: PickerPath, time_s: float) -> float:
    """Return when a picker that is closed at a time has closed; if it is open, the time itself."""
    place = int(np.searchsorted(path.time_s, time_s + 1e-9, side="right")) - 1
    since = time_s
    while place >= 0 and path.closed[place]:
        since = min(since, float(path.time_s[place]))
        place -= 1
    return since


def _closed_until(path: PickerPath, time_s: float) -> float:
    """Return when a picker that is closed at a time opens; if it is open, the time itself."""
    if not path.closed_at(time_s):
        return time_s
    later = (path.time_s > time_s) & ~path.closed
    return float(path.time_s[later][0]) if later.any() else float(path.time_s[-1])


def _way_m(path: PickerPath, first_s: float, last_s: float) -> float:
    """Return the largest distance of a tip from its position at the first time [m]."""
    spots = np.stack([path.position_at(time) for time in np.linspace(first_s, last_s, 20)])
    return float(np.linalg.norm(spots - spots[0], axis=1).max())
