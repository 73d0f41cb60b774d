"""Checks of the times against each other: their unit, gaps, and how fast a picker can be."""

from itertools import pairwise

import numpy as np

from clothtrack.recordings.geometry_checks.finding import Finding
from clothtrack.recordings.recording import PickerPath, Recording

LONGEST_STEP_S, SHORTEST_STEP_S = 5.0, 0.002
"""Limits of the median time between frames [s] beyond which a clock is not in seconds: cameras take
1 to 300 pictures per second; at 30 per second, milliseconds look like 33 s and microseconds like
33,333."""

SLOWEST_M_S, FASTEST_M_S = 0.002, 5.0
"""Limits of the median speed of a moving closed tip [m/s]: cloth is carried at 0.05 to 1."""

_LARGEST_GAP = 3.0
"""Multiple of the median step between frames from which a step is a gap; at least 0.25 s."""

_LEAST_GAP_S = 0.25
_LEAST_GAP_M = 0.05
"""A gap matters if a closed tip moves this far in it [m], because the cloth was not seen."""

_JUMP, _LEAST_JUMP_S = 100.0, 1.0
"""A step is a jump of the clock above this multiple of the median step, and this time [s]."""

_GAP_SAMPLES = 30
"""Number of times within a gap at which the picker's path is sampled."""

UNEVEN, LARGEST_JITTER = 0.3, 0.2
"""A step is uneven if it differs from the median one by more than this share of it. The second is
the share of the steps that may be uneven, because cameras drop a frame now and then."""


def time_findings(recording: Recording) -> list[Finding]:
    """Return what is wrong with the recorded times, without looking at the pictures."""
    times = np.array([frame.time_s for frame in recording.frames])
    if len(times) < 5:
        return []
    return _unit(recording, times) or [*_gaps(recording, times), *_jitter(times)]


def _unit(recording: Recording, times: np.ndarray) -> list[Finding]:
    """Return a finding for steps of no camera, or a tip too slow or too fast to carry cloth."""
    step_s = float(np.median(np.diff(times)))
    speed = _speed_m_s(recording)
    wrong_step = not SHORTEST_STEP_S <= step_s <= LONGEST_STEP_S
    wrong_speed = speed is not None and not SLOWEST_M_S <= speed <= FASTEST_M_S
    if not (wrong_speed or (wrong_step and speed is None)):
        return []
    factor = _factor(step_s)
    told = f"the frames are {step_s:.3g} s apart"
    if speed is not None:
        told += f" and the closed picker moves at {speed:.2g} m/s"
    remedy = "write time_s of frames and of picker.csv in seconds, by one clock"
    if factor is not None:
        remedy += f"; all times {factor:g} times as large would be those of a camera"
    limit = LONGEST_STEP_S if step_s > LONGEST_STEP_S else SHORTEST_STEP_S
    if not wrong_step:
        step_s, limit = (
            float(speed or 0.0),
            SLOWEST_M_S if (speed or 0.0) < SLOWEST_M_S else FASTEST_M_S,
        )
    return [
        Finding(
            "clock_unit", step_s, limit, "s" if wrong_step else "m/s", "frames: time_s",
            f"{told}: {remedy}",
        )
    ]  # fmt: skip


def _factor(step_s: float) -> float | None:
    """Return the power of a thousand that makes a step one of 4 to 250 pictures per second."""
    for factor in (1e-3, 1e-6, 1e-9, 1e3):
        if 0.004 <= step_s * factor <= 0.25:
            return factor
    return None


def _speed_m_s(recording: Recording) -> float | None:
    """Return the median speed [m/s] of closed tips while they move; None below 5 cm in all."""
    speeds, gone_m = [], 0.0
    for path in recording.picker_paths.values():
        away = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
        held = path.closed[:-1] & (away > 1e-4)
        gone_m += float(away[held].sum())
        speeds += (away[held] / np.diff(path.time_s)[held]).tolist()
    return float(np.median(speeds)) if gone_m >= _LEAST_GAP_M else None


def _gaps(recording: Recording, times: np.ndarray) -> list[Finding]:
    """Return the first jump of the clock, and the first gap in which a closed picker moves on."""
    middle_s = float(np.median(np.diff(times)))
    gap_s, jump_s = max(_LARGEST_GAP * middle_s, _LEAST_GAP_S), max(_JUMP * middle_s, _LEAST_JUMP_S)
    found: dict[str, Finding] = {}
    for frame, (before, after) in enumerate(pairwise(times.tolist())):
        step_s, field = after - before, f"frames[{frame + 1}]: time_s"
        if step_s > jump_s and "clock_jump" not in found:
            held = bool(held_over(recording, frame))
            remedy = gap_remedy(step_s - middle_s, held=held)
            found["clock_jump"] = Finding(
                "clock_jump", step_s, jump_s, "s", field,
                f"time_s steps by {step_s:.6g} s from frame {frame} to frame {frame + 1} (at most "
                f"{jump_s:.3g}): {remedy}",
                severity="doubt" if held else "note",
            )  # fmt: skip
        if not gap_s < step_s <= jump_s or "frame_gap" in found:
            continue
        gone_m = max((_carried_m(one, before, after) for one in recording.picker_paths.values()),
                     default=0.0)  # fmt: skip
        if gone_m > _LEAST_GAP_M:
            found["frame_gap"] = Finding(
                "frame_gap", step_s, gap_s, "s", field,
                f"no frame for {step_s:.2f} s after frame {frame} (at most {gap_s:.2f}), while the "
                f"closed picker goes {100 * gone_m:.0f} cm: record without gaps, or end the action "
                "at the gap",
            )  # fmt: skip
    return list(found.values())


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


def _carried_m(path: PickerPath, start_s: float, end_s: float) -> float:
    """Return how far a picker moves while it is closed, between two times [m]."""
    times = np.linspace(start_s, end_s, _GAP_SAMPLES)
    closed = np.array([path.closed_at(time_s) for time_s in times])
    steps_m = np.linalg.norm(
        np.diff([path.position_at(time_s) for time_s in times], axis=0), axis=1
    )
    return float(steps_m[closed[:-1] & closed[1:]].sum())


def _jitter(times: np.ndarray) -> list[Finding]:
    steps = np.diff(times)
    middle = float(np.median(steps))
    jitter = float((np.abs(steps - middle) > UNEVEN * middle).mean())
    if jitter <= LARGEST_JITTER:
        return []
    return [
        Finding(
            "frame_spacing", jitter, LARGEST_JITTER, "", "frames: time_s",
            f"{100 * jitter:.0f} % of the times between frames differ by more than "
            f"{100 * UNEVEN:.0f} % from the middle one, {middle:.3g} s (at most "
            f"{100 * LARGEST_JITTER:.0f} %): write the camera's own time stamps",
            severity="note",
        )
    ]  # fmt: skip
