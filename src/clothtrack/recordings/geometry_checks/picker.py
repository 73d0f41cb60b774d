"""Measures of the times, and of the picker: it closes on cloth, and carries it.

Carried cloth is where the tip is. A tip whose times are late is still in the air when the cloth has
been laid down, and on the table when the cloth is in the air. The path is therefore shifted in
time, and the lag at which it fits the observed cloth best is the clock's error.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.distance import cdist

from clothtrack.recordings.geometry_checks.finding import Measured, ObservedFrames, reaches_rim
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import PickerPath, Recording

_STEPS_S = (0.002, 5.0)
"""Median time between frames [s] outside of which a clock is not in seconds: cameras take 1 to 300
pictures per second; at 30 per second, milliseconds look like 33 s."""

_SPEEDS_M_S = (0.002, 5.0)
"""The same for the median speed of a moving closed tip [m/s]: cloth is carried at 0.05 to 1."""

_GAP, _LEAST_GAP_S, _LEAST_GAP_M = 3.0, 0.25, 0.05
"""A step of this multiple of the median step and this time [s] is a gap; it matters if a closed tip
moves so far in it [m], because the cloth was not seen."""

_JUMP, _LEAST_JUMP_S = 100.0, 1.0
"""A step is a jump of the clock above this multiple of the median step, and this time [s]."""

UNEVEN = 0.3
"""A step is uneven if it differs from the median one by more than this share of it."""

REACH_M = 0.03
"""A tip that closes farther from the cloth than this [m] holds nothing (`tracking.picking`). On
right recordings it closes within 9 mm, or within 22 mm if depth is missing there."""

_HIDDEN_M = 0.05
"""A tip behind a tool or hand, where nothing can be measured, may have unseen cloth beside it. An
arm and hand that reach over the cloth hide everything nearer than this [m]."""

_CARRIED_FRAMES = 12
"""Number of frames of each action that are checked while its picker is closed."""

_LARGEST_LAG_S = 0.2
"""Difference of the two clocks [s] from which they are doubted, at least one and a half frames.
Right recordings are never doubted below `_LEAST_GAIN_M`, whatever their lag."""

FARTHEST_LAG_S, _LAG_STEP_S = 1.5, 0.05
"""Largest lag that is tried, and the difference between those that are tried [s]."""

_LEAST_GAIN_M = 0.008
"""Least reduction of the mean distance from the cloth by the lag [m] for a clock to be doubted."""

_LARGEST_REST_M = 0.01
"""Mean distance of the shifted path from the cloth [m] above which no lag explains the path."""

_FAR_M = 0.04
"""Distances from the cloth are clipped to this [m], because the tool may hide its own tip."""

_LEAST_SHARE = 0.8
"""Share of the closed time that must fall on frames with the lag."""

LAG_FRAMES = 40
"""Number of frames used for the lag, spread over the actions; each costs some 30 ms."""


def clock_units(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield steps of no camera [s], or a tip too slow or too fast to carry cloth [m/s]."""
    step_s, speed = frames.once(_step_s), _speed_m_s(frames.recording)
    if step_s is None:
        return
    wrong_step = not _STEPS_S[0] <= step_s <= _STEPS_S[1]
    wrong_speed = speed is not None and not _SPEEDS_M_S[0] <= speed <= _SPEEDS_M_S[1]
    if not wrong_speed and (speed is not None or not wrong_step):
        return
    moves = "" if speed is None else f" and the closed picker moves at {speed:.2g} m/s"
    known = [factor for factor in (1e-3, 1e-6, 1e-9, 1e3) if 0.004 <= step_s * factor <= 0.25]
    measured, (low, high) = (step_s, _STEPS_S) if wrong_step else (speed or 0.0, _SPEEDS_M_S)
    yield {
        "measured": measured, "limit": high if measured > high else low, "step_s": step_s,
        "unit": "s" if wrong_step else "m/s", "moves": moves,
        "likely": f"; all times {known[0]:g} times as large would be those of a camera"
        if known else "",
    }  # fmt: skip


def clock_jumps(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the first step between frames that no pause explains [s]."""
    middle_s = frames.once(_step_s) or np.inf
    for frame, step_s, jump_s in _steps(frames):
        if step_s > jump_s:
            held = bool(held_over(frames.recording, frame))
            yield {
                "measured": step_s, "limit": jump_s, "frame": frame, "next": frame + 1,
                "remedy": gap_remedy(step_s - middle_s, held=held),
                "severity": "doubt" if held else "note",
            }  # fmt: skip
            return


def frame_gaps(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the first gap between frames in which a closed picker moves on [s]."""
    recording = frames.recording
    gap_s = max(_GAP * (frames.once(_step_s) or np.inf), _LEAST_GAP_S)
    for frame, step_s, jump_s in _steps(frames):
        if gap_s < step_s <= jump_s:
            span = recording.frames[frame].time_s, recording.frames[frame + 1].time_s
            paths = recording.picker_paths.values()
            gone_m = max((_carried_m(path, *span) for path in paths), default=0.0)
            if gone_m > _LEAST_GAP_M:
                yield {
                    "measured": step_s, "limit": gap_s, "frame": frame, "next": frame + 1,
                    "gone_m": gone_m,
                }  # fmt: skip
                return


def uneven_steps(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the share of the steps between frames that differ from the median one."""
    middle_s = frames.once(_step_s)
    if middle_s is not None:
        steps = np.diff([frame.time_s for frame in frames.recording.frames])
        share = float((np.abs(steps - middle_s) > UNEVEN * middle_s).mean())
        yield {"measured": share, "most": UNEVEN, "middle_s": middle_s}


def gap_remedy(extra_s: float, *, held: bool) -> str:
    """Return what to do about a step that is longer than usual by a time [s]."""
    paused = "leave the action out, for nothing shows what it did" if held else "leave it"
    return (
        f"if the clock was set, subtract {extra_s:.6g} from all later time_s of recording.json and "
        f"picker.csv; if the camera paused, {paused}"
    )


def held_over(recording: Recording, frame: int) -> str:
    """Return the picker of an action that is closed between a frame and the next, or nothing."""
    start_s, end_s = (recording.frames[place].time_s for place in (frame, frame + 1))
    for action in recording.actions:
        for name in action.pickers if action.first_frame <= frame < action.last_frame else ():
            path = recording.picker_paths[name]
            inside = (path.time_s > start_s) & (path.time_s < end_s)
            if path.closed_at(start_s) or path.closed[inside].any():
                return name
    return ""


def _step_s(frames: ObservedFrames) -> float | None:
    """Return the median time between frames [s]; None for fewer than five."""
    times = [frame.time_s for frame in frames.recording.frames]
    return float(np.median(np.diff(times))) if len(times) >= 5 else None


def _steps(frames: ObservedFrames) -> Iterator[tuple[int, float, float]]:
    """Yield the number of each frame but the last, the step after it, and that of a jump [s]."""
    jump_s = max(_JUMP * (frames.once(_step_s) or np.inf), _LEAST_JUMP_S)
    for frame, (before, after) in enumerate(pairwise(frames.recording.frames)):
        yield frame, after.time_s - before.time_s, jump_s


def _speed_m_s(recording: Recording) -> float | None:
    """Return the median speed [m/s] of closed tips while they move; None below 5 cm in all."""
    speeds, gone_m = [], 0.0
    for path in recording.picker_paths.values():
        away = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
        held = path.closed[:-1] & (away > 1e-4)
        gone_m += float(away[held].sum())
        speeds += (away[held] / np.diff(path.time_s)[held]).tolist()
    return float(np.median(speeds)) if gone_m >= _LEAST_GAP_M else None


def _carried_m(path: PickerPath, start_s: float, end_s: float) -> float:
    """Return how far a picker moves while it is closed, between two times [m]."""
    times = np.linspace(start_s, end_s, 30)
    closed = np.array([path.closed_at(time_s) for time_s in times])
    tips = [path.position_at(time_s) for time_s in times]
    steps_m = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    return float(steps_m[closed[:-1] & closed[1:]].sum())


@dataclass(frozen=True)
class _Hold:
    """One picker in one action, from 1, and the frames of the action in which it is closed."""

    action: int
    name: str
    first: int
    closed: tuple[int, ...]
    path: PickerPath


def never_closed(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield pickers that are closed in no frame of their action."""
    for hold in frames.once(_holds):
        if not hold.closed:
            yield {"measured": 0.0, "limit": 1.0, "picker": hold.name, "action": hold.action}


def closing_gaps(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the distance of a closing tip from the cloth [m]."""
    for hold, gap_m, limit_m in frames.once(_closing):
        if gap_m > limit_m:
            yield {
                "measured": gap_m, "limit": limit_m, "picker": hold.name, "action": hold.action,
                "time_s": frames.recording.frames[hold.closed[0]].time_s,
            }  # fmt: skip


def carried_gaps(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the distance from the cloth that a quarter of a closed tip's frames exceed [m]."""
    for hold, closing_m, limit_m in frames.once(_closing):
        if closing_m > limit_m:
            continue
        places = np.linspace(0, len(hold.closed) - 1, _CARRIED_FRAMES).round().astype(int)
        gaps = []
        for frame in (hold.closed[place] for place in np.unique(places)):
            seen, tip = frames.at(frame), _tip(frames, hold, frame)
            if seen is not None and len(seen.points) and not _beyond(seen, tip):
                gaps.append(carried_distances_m(seen, tip[None], _allowance_m(frames.recording))[0])
        gap_m = float(np.percentile(gaps, 75)) if gaps else 0.0
        yield {"measured": gap_m, "picker": hold.name, "action": hold.action}


def _held_by_name(recording: Recording, picker: str) -> bool:
    """Return whether the recording says what the picker holds; its tip need not be there then."""
    return picker in recording.cloth.held_vertices


def _allowance_m(recording: Recording) -> float:
    """Return the additional distance that a right tip may have from the cloth's points [m]."""
    return recording.observed.tool_clearance_m + recording.cloth.grasp_uncertainty_m


def _holds(frames: ObservedFrames) -> list[_Hold]:
    recording, holds = frames.recording, []
    for number, action in enumerate(recording.actions, start=1):
        for name in action.pickers:
            if not _held_by_name(recording, name):
                path = recording.picker_paths[name]
                span = range(action.first_frame, action.last_frame + 1)
                closed = tuple(i for i in span if path.closed_at(recording.frames[i].time_s))
                holds.append(_Hold(number, name, action.first_frame, closed, path))
    return holds


def _closing(frames: ObservedFrames) -> list[tuple[_Hold, float, float]]:
    """Return each hold, the distance of its closing tip from the cloth, and the limit [m].

    The distance is the smaller one of then and of when the action starts, because a hand may hide
    the cloth when the picker closes; 0 where nothing is seen.
    """
    limit_m, found = REACH_M + _allowance_m(frames.recording), []
    for hold in frames.once(_holds):
        if not hold.closed:
            continue
        tip = _tip(frames, hold, hold.closed[0])
        gaps = [
            float(_distances_m(seen, tip[None])[0])
            for seen in (frames.at(hold.first), frames.at(hold.closed[0]))
            if seen is not None and len(seen.points) and not _beyond(seen, tip)
        ]
        found.append((hold, min(gaps, default=0.0), limit_m))
    return found


def _tip(frames: ObservedFrames, hold: _Hold, frame: int) -> Float[np.ndarray, " 3"]:
    return hold.path.position_at(frames.recording.frames[frame].time_s)


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


def _distances_m(
    seen: Observation, tips: Float[np.ndarray, "tips 3"]
) -> Float[np.ndarray, " tips"]:
    """Return the distances of tips from the nearest point of the cloth [m].

    This is for few tips: building a tree of the points takes longer than trying all.
    """
    return cdist(tips, seen.points).min(axis=1)


@dataclass(frozen=True)
class ClockLag:
    """The lag of the picker's clock against that of the pictures.

    Attributes:
        lag_s: how long after the tip the cloth moves, by the recorded times [s]; below 0 if the
            picker's times are late.
        unshifted_m: mean distance of the closed tips from the cloth, as recorded [m].
        shifted_m: the same with the lag removed [m].
    """

    lag_s: float
    unshifted_m: float
    shifted_m: float

    def is_wrong(self, times_s: Sequence[float]) -> bool:
        """Return whether the clock is clearly wrong, for pictures at these times [s]."""
        clear = (
            self.shifted_m <= _LARGEST_REST_M and self.unshifted_m - self.shifted_m >= _LEAST_GAIN_M
        )
        return clear and abs(self.lag_s) > _largest_lag_s(times_s)


def _largest_lag_s(times_s: Sequence[float]) -> float:
    """Return the largest lag [s] that is not doubted for pictures at these times [s]."""
    return max(_LARGEST_LAG_S, 1.5 * float(np.median(np.diff(times_s))))


def clock_lags(frames: ObservedFrames) -> Iterator[Measured]:
    """Yield the lag of a picker's clock that clearly runs before or behind the pictures' [s]."""
    total_m, count = _beside(frames, np.zeros(1))
    if total_m[0] < _LEAST_GAIN_M * max(count[0], 1.0):
        return  # No lag can bring the path so much nearer, so none is tried.
    lag, times_s = picker_lag(frames), [frame.time_s for frame in frames.recording.frames]
    if lag is not None and lag.is_wrong(times_s):
        order, change = ("before", "subtract") if lag.lag_s < 0 else ("after", "add")
        yield {
            "measured": lag.lag_s, "limit": _largest_lag_s(times_s), "size": abs(lag.lag_s),
            "order": order, "change": change,
        }  # fmt: skip


def picker_lag(frames: ObservedFrames) -> ClockLag | None:
    """Return the lag at which the closed tips are nearest to the cloth.

    None if it cannot be found: no action, or only pickers whose held vertices are recorded.
    """
    lags = np.arange(-FARTHEST_LAG_S, FARTHEST_LAG_S + 0.5 * _LAG_STEP_S, _LAG_STEP_S)
    total, count = _beside(frames, lags)
    none = int(np.argmin(np.abs(lags)))
    enough = count >= max(_LEAST_SHARE * count.max(), 3.0)
    if not enough[none]:
        return None
    mean = np.where(enough, total / np.maximum(count, 1.0), np.inf)
    best = int(np.argmin(mean))
    return ClockLag(float(lags[best]), float(mean[none]), float(mean[best]))


def _beside(
    frames: ObservedFrames, lags: Float[np.ndarray, " lags"]
) -> tuple[Float[np.ndarray, " lags"], Float[np.ndarray, " lags"]]:
    """Return the sum of the distances of closed tips from the cloth [m], and their number."""
    recording, total, count = frames.recording, *np.zeros((2, len(lags)))
    paths = [p for name, p in recording.picker_paths.items() if not _held_by_name(recording, name)]
    if not recording.actions:
        return total, count
    first, last = recording.actions[0].first_frame, recording.actions[-1].last_frame
    for frame in np.unique(np.linspace(first, last, LAG_FRAMES).round().astype(int)).tolist():
        times = recording.frames[frame].time_s - lags
        for path in paths:
            closed = _closed(path, times)
            seen = frames.at(frame) if closed.any() else None
            if seen is None or not len(seen.points):
                continue
            tips = np.stack([np.interp(times[closed], path.time_s, a) for a in path.positions.T], 1)
            beside = carried_distances_m(seen, tips, _allowance_m(recording))
            total[closed] += np.minimum(beside, _FAR_M)
            count[closed] += 1.0
    return total, count


def _closed(path: PickerPath, times: Float[np.ndarray, " times"]) -> np.ndarray:
    """Return at which of these times of its own clock a picker is closed."""
    place = np.searchsorted(path.time_s, times + 1e-9, side="right") - 1
    inside = (place >= 0) & (times <= path.time_s[-1])
    return inside & path.closed[np.clip(place, 0, None)]
