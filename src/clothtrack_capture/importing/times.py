"""When each picture was taken, and which belong together.

A time stamp is believed if the order of writing, its times and the other stream agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.source import StreamFrame, Streams

LARGEST_TOLERANCE_S = 1.0
_LONE_TOLERANCE_NS = 20e6
_TWO_CLOCKS_NS = 5e8
"""Difference between depth and color, each stamp against its time of writing, of two clocks."""
_JUMP_STEPS, _LEAST_JUMP_NS = 100, 1e9
"""A step is a jump beyond this many median steps, and beyond this time."""
_SAME_DENSITY = (0.5, 1.5)
"""Pictures per median step between a stamp that falls behind and the latest one, if messages were
only written in another order; a clock that was set back fills that time twice, or not at all."""


def timed(
    source: Path, streams: Streams, options: ImportOptions
) -> tuple[dict[str, list[StreamFrame]], list[str]]:
    """Return the pictures of each stream with their times, in the order of writing, and remarks."""
    notes: list[str] = []
    result = {"depth": list(streams.depth)}
    if streams.color is not None:
        result["color"] = list(streams.color)
    if options.stamps == "written":
        for name, frames in result.items():
            if any(frame.written_ns is None for frame in frames):
                raise InvalidConfigError(
                    f"--stamps written: {source} does not tell when its pictures were written; "
                    "leave it out"
                )
            result[name] = [replace(frame, time_ns=frame.written_ns) for frame in frames]
    else:
        for name, frames in result.items():
            result[name] = _filled(name, frames, notes)
            _check_order(source, name, result[name])
    if options.color_offset_s is not None:
        shift_ns = round(options.color_offset_s * 1e9)
        result["color"] = [
            replace(frame, time_ns=frame.time_ns + shift_ns) for frame in result.get("color", ())
        ]
    elif options.stamps == "header" and "color" in result:
        _check_clocks(source, result["depth"], result["color"])
    told: list[tuple[int, int]] = []
    for name, frames in result.items():
        notes += _jumps(name, frames, told, options)
    return result, notes


def _filled(name: str, frames: list[StreamFrame], notes: list[str]) -> list[StreamFrame]:
    """Return the pictures, those without a stamp placed by their times of writing."""
    missing = [number for number, frame in enumerate(frames) if not frame.stamped]
    if not missing or len(missing) == len(frames):
        return frames
    late_ns = _late_ns(frames) or 0
    notes.append(
        f"{len(missing)} pictures of {name} have no time stamp (the first is number {missing[0]}, "
        f"the last {missing[-1]}); their times of writing stand for them"
    )
    return [
        frame if frame.stamped else replace(frame, time_ns=frame.time_ns - late_ns)
        for frame in frames
    ]


def _late_ns(frames: Sequence[StreamFrame]) -> int | None:
    """Return the time of writing minus the stamp [ns], the median; None if none is known."""
    late = [f.written_ns - f.time_ns for f in frames if f.stamped and f.written_ns is not None]
    return int(np.median(late)) if late else None


def _check_order(source: Path, name: str, frames: Sequence[StreamFrame]) -> None:
    # A message that was recorded twice has its stamp and its time of writing twice.
    frames = list({(frame.time_ns, frame.written_ns or k): frame
                   for k, frame in enumerate(frames)}.values())  # fmt: skip
    times = _times(frames)
    ahead = np.diff(times)
    ahead = ahead[ahead > 0]
    if not len(ahead):
        return
    step, ranked, latest = float(np.median(ahead)), np.sort(times), np.maximum.accumulate(times)
    within = np.searchsorted(ranked, latest, side="right") - np.searchsorted(ranked, times)
    density = within / ((latest - times) / step + 1)
    falls = np.concatenate([[False], np.diff(times) < 0]) & (latest - times > 1.5 * step)
    low, high = _SAME_DENSITY
    wrong = np.flatnonzero(falls & ((density < low) | (density > high)))
    if len(wrong):
        here = int(wrong[0])
        before = int(np.argmax(times[:here]))
        remedy = "cut the source there and import the parts"
        if _is_usable(frames):
            remedy = "give --stamps written for the times of writing, which run on"
        raise InvalidRecordingError(
            f"{source}: the time stamps of {name} run backwards: picture {here} has "
            f"{times[here] / 1e9:.3f} s, but picture {before}, written before it, has "
            f"{times[before] / 1e9:.3f} s; a clock was set back, or these are two takes; {remedy}"
        )


def _is_usable(frames: Sequence[StreamFrame]) -> bool:
    """Return whether the times of writing are known and advance."""
    if any(frame.written_ns is None for frame in frames):
        return False
    written = np.array([frame.written_ns for frame in frames])
    return len(np.unique(written)) > 0.9 * len(written)


def _check_clocks(source: Path, depth: Sequence[StreamFrame], color: Sequence[StreamFrame]) -> None:
    late, other = _late_ns(depth), _late_ns(color)
    if late is None or other is None or abs(other - late) <= _TWO_CLOCKS_NS:
        return
    way = "behind" if other > late else "ahead"
    written = "give --stamps written, or " if _is_usable(depth) and _is_usable(color) else "give "
    raise InvalidRecordingError(
        f"{source}: depth and color are stamped by two clocks: by the times of writing, color's is "
        f"{abs(other - late) / 1e9:.3f} s {way}; {written}--color-offset-s "
        f"{(other - late) / 1e9:.3f}"
    )


def _jumps(
    name: str,
    frames: Sequence[StreamFrame],
    told: list[tuple[int, int]],
    options: ImportOptions,
) -> list[str]:
    """Return a remark on each jump of the times; `told` has those of the streams before."""
    if len(frames) < 3:
        return []
    order = sorted(range(len(frames)), key=lambda number: frames[number].time_ns)
    times = _times(frames)[order]
    steps = np.diff(times)
    usual = float(np.median(steps))
    notes = []
    for k in np.flatnonzero(steps > max(_JUMP_STEPS * usual, _LEAST_JUMP_NS)).tolist():
        span = (int(times[k]), int(times[k + 1]))
        if any(span[0] < stop and start < span[1] for start, stop in told):
            continue
        told.append(span)
        first, second = frames[order[k]], frames[order[k + 1]]
        remedy = (
            "if a clock was set meanwhile, cut the source there; if nothing moved meanwhile, leave "
            "it (`track` simulates at most 2 s of a pause)"
        )
        if options.stamps == "header" and second.written_ns is not None:
            apart_ns = second.written_ns - (first.written_ns or 0)
            if apart_ns < steps[k] / 2 and _is_usable(frames):
                remedy = (
                    f"a clock was set: they were written {apart_ns / 1e9:.3f} s apart; give "
                    "--stamps written"
                )
        notes.append(
            f"the times of {name} jump from {span[0] / 1e9:.3f} to {span[1] / 1e9:.3f} s, by "
            f"{steps[k] / 1e9:.1f} s between pictures {order[k]} and {order[k + 1]} (usual: "
            f"{usual / 1e9:.3f} s); {remedy}"
        )
    return notes


def _times(frames: Sequence[StreamFrame]) -> Int64[np.ndarray, " frames"]:
    return np.array([frame.time_ns for frame in frames], dtype=np.int64)


@dataclass(frozen=True)
class Pair:
    """A depth picture and its color picture, or None if there is no color stream."""

    depth: StreamFrame
    color: StreamFrame | None


@dataclass(frozen=True)
class Pairing:
    """The pairs in order of time, what was left out, and the tolerance that would take in more."""

    pairs: tuple[Pair, ...]
    tolerance_s: float
    depth_alone: int
    color_alone: int
    doubles: int
    worst_s: float
    advice: str = ""


def pair(
    path: Path,
    depth: Sequence[StreamFrame],
    color: Sequence[StreamFrame] | None,
    options: ImportOptions,
) -> Pairing:
    """Pair depth and color by time: each the other's nearest, within the tolerance.

    Args:
        path: path of the source, for error messages.
        depth: depth pictures in any order.
        color: color pictures in any order, or None if there is no color stream.
        options: options with the largest time difference [s]; half the time between depth
            pictures by default.
    """
    if not depth:
        raise InvalidRecordingError(
            f"{path}: not one whole depth picture; record it again, or name others"
        )
    ordered = sorted(depth, key=lambda frame: frame.time_ns)
    single = [
        frame for k, frame in enumerate(ordered) if not k or frame.time_ns > ordered[k - 1].time_ns
    ]
    doubles = len(ordered) - len(single)
    times = np.array([frame.time_ns for frame in single])
    tolerance = _tolerance_ns(times, options.tolerance_s)
    if color is None:
        pairs = tuple(Pair(frame, None) for frame in single)
        return Pairing(pairs, tolerance / 1e9, 0, 0, doubles, 0.0)
    if not color:
        raise InvalidRecordingError(
            f"{path}: not one whole color picture; give --without-color to import depth alone"
        )
    others = sorted(color, key=lambda frame: frame.time_ns)
    other_times = np.array([frame.time_ns for frame in others])
    mine, yours = _nearest(times, other_times), _nearest(other_times, times)
    apart = np.abs(times - other_times[mine])
    mutual = yours[mine] == np.arange(len(times))
    chosen = np.flatnonzero(mutual & (apart <= tolerance))
    advice = _advice(apart[mutual & (apart > tolerance)])
    if not len(chosen):
        if not advice:
            offset_s = (options.color_offset_s or 0.0) + (int(times[0]) - int(other_times[0])) / 1e9
            advice = f"--color-offset-s {offset_s:.3f} if color has a clock of its own"
        raise InvalidRecordingError(
            f"{path}: no color picture within {tolerance / 1e6:.1f} ms of a depth picture; the "
            f"nearest is {apart.min() / 1e6:.1f} ms away; give {advice}, or --without-color"
        )
    return Pairing(
        tuple(Pair(single[k], others[mine[k]]) for k in chosen.tolist()),
        tolerance / 1e9,
        len(single) - len(chosen),
        len(others) - len(chosen),
        doubles,
        float(apart[chosen].max()) / 1e9,
        advice,
    )


def _advice(apart: np.ndarray) -> str:
    """Return the flag that includes half of the pairs that are too far apart [ns], and its cost."""
    if not len(apart):
        return ""
    tolerance_ms = float(np.ceil(np.median(apart) / 1e6 + 0.5))
    if tolerance_ms > 1e3 * LARGEST_TOLERANCE_S:
        return ""
    count = int((apart <= tolerance_ms * 1e6).sum())
    frames = "1 frame" if count == 1 else f"{count} frames"
    return (
        f"--tolerance-s {tolerance_ms / 1e3:.3f} for {frames} more, if nothing moves much in "
        f"{tolerance_ms:.0f} ms"
    )


def _tolerance_ns(times: np.ndarray, asked_s: float | None) -> float:
    if asked_s is not None:
        return asked_s * 1e9
    return float(np.median(np.diff(times))) / 2 if len(times) > 1 else _LONE_TOLERANCE_NS


def _nearest(times: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the index of the nearest of `others` (sorted) for each time."""
    after = np.searchsorted(others, times).clip(1, max(len(others) - 1, 1))
    if len(others) == 1:
        return np.zeros(len(times), dtype=int)
    return np.where(times - others[after - 1] <= others[after] - times, after - 1, after)
