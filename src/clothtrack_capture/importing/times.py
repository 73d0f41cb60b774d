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
_TWO_CLOCKS_NS, _LATE_NS, _DRIFT_NS = 5e8, 2.5e8, 1e8
"""Difference of two streams, each stamp against its time of writing: of two clocks; worth a word;
from the first to the last pictures."""
_JUMP_STEPS, _LEAST_JUMP_NS = 100, 1e9
"""A step is a jump beyond this many median steps, and beyond this time."""
_FASTEST_NS, _SLOWEST_NS = 1e6, 5e9
"""Usual steps beyond these are not those of a camera."""
_SEVERAL_CLOCKS = ("/tf",)
"""Topics that several programs write, each in its own order."""
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
        result = {name: _written(source, frames) for name, frames in result.items()}
    else:
        result = {name: _filled(name, frames, notes) for name, frames in result.items()}
        others = dict(streams.marks)
        if "color" in result and options.color_offset_s is None:
            others["color"] = result["color"]
        for name, frames in {**result, **others}.items():
            if name not in _SEVERAL_CLOCKS:
                _check_order(source, name, frames)
        for name, frames in others.items():
            notes += _clocks(source, result["depth"], name, frames)
    if options.color_offset_s is not None and "color" not in result:
        raise InvalidConfigError("--color-offset-s: there is no color; leave it out")
    shift_ns = round((options.color_offset_s or 0.0) * 1e9)
    if shift_ns:
        result["color"] = [replace(one, time_ns=one.time_ns + shift_ns) for one in result["color"]]
    told: list[tuple[int, int]] = []
    for name, frames in result.items():
        notes += _jumps(name, frames, told, options)
    return result, notes


def _written(source: Path, frames: Sequence[StreamFrame]) -> list[StreamFrame]:
    if any(frame.written_ns is None for frame in frames):
        raise InvalidConfigError(
            f"--stamps written: {source} does not tell when its pictures were written; leave it out"
        )
    return [replace(frame, time_ns=frame.written_ns) for frame in frames]


def _filled(name: str, frames: list[StreamFrame], notes: list[str]) -> list[StreamFrame]:
    """Return the pictures, those without a stamp placed by their times of writing."""
    missing = [number for number, frame in enumerate(frames) if not frame.stamped]
    if not missing or len(missing) == len(frames):
        return frames
    if missing == [0] and frames[1].time_ns < _LEAST_JUMP_NS:
        return [replace(frames[0], time_ns=0), *frames[1:]]  # a simulator's clock begins at 0
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


def _clocks(
    source: Path, depth: Sequence[StreamFrame], name: str, frames: Sequence[StreamFrame]
) -> list[str]:
    """Return remarks on another stream's clock, by the times of writing; refuse a second clock."""
    late, other = _late_ns(depth), _late_ns(frames)
    if late is None or other is None or not any(frame.stamped for frame in depth):
        return []
    apart = other - late
    color = f"--color-offset-s {apart / 1e9:.3f}" if name == "color" else ""
    written = "--stamps written" if _is_usable(depth) and _is_usable(frames) else ""
    remedy = f"give {' or '.join(filter(None, (written, color)))}"
    words = f"{abs(apart) / 1e9:.3f} s {'behind' if apart > 0 else 'ahead'}"
    if abs(apart) > _TWO_CLOCKS_NS:
        raise InvalidRecordingError(
            f"{source}: depth and {name} are stamped by two clocks: by the times of writing, that "
            f"of {name} is {words}; {remedy}"
        )
    fifth = len(depth) // 5, len(frames) // 5
    pairs = list(zip((depth, frames), fifth, strict=True))
    starts = [_late_ns(stream[:count]) for stream, count in pairs]
    ends = [_late_ns(stream[-count:]) for stream, count in pairs]
    if min(fifth) > 1 and None not in (*starts, *ends):
        drift = (ends[1] or 0) - (ends[0] or 0) - (starts[1] or 0) + (starts[0] or 0)
        if abs(drift) > _DRIFT_NS:
            return [f"the clock of {name} drifts by {drift / 1e9:.3f} s against that of depth; "
                    "give --stamps written"]  # fmt: skip
    if abs(apart) > _LATE_NS:
        return [f"by the times of writing, the stamps of {name} are {words} of those of depth; if "
                f"it has a clock of its own, {remedy}"]  # fmt: skip
    return []


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
    usual = float(np.median(steps[steps > 0])) if steps.any() else 1.0
    notes = []
    if steps.any() and not _SLOWEST_NS > usual > _FASTEST_NS:
        notes.append(
            f"{1e9 / usual:.3g} pictures of {name} per second: check the unit of their times"
        )
    jumps = steps > max(_JUMP_STEPS * usual, _LEAST_JUMP_NS)
    if options.stamps == "header" and _is_usable(frames):
        written = np.diff([frames[number].written_ns or 0 for number in order])
        jumps |= (steps > 3 * usual) & (np.abs(steps - written) > _LATE_NS)
    for k in np.flatnonzero(jumps).tolist():
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
