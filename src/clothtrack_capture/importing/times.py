"""When each picture was taken, by stamps that the order of writing confirms, and its partner."""

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
# Difference of two streams' delays of writing: of two clocks; worth a word; from start to end.
_TWO_CLOCKS_NS, _LATE_NS, _DRIFT_NS = 5e8, 2.5e8, 1e8
# A step is a jump beyond this many median steps, and beyond this time.
_JUMP_STEPS, _LEAST_JUMP_NS = 100, 1e9
_FASTEST_NS, _SLOWEST_NS = 1e6, 5e9  # usual steps of a camera lie between
_SEVERAL_CLOCKS = ("/tf",)  # several programs write it, each in its own order
# Pictures per median step between a stamp that falls behind and the latest one, if messages were
# only written in another order; a clock that was set back fills that time twice, or not at all.
_SAME_DENSITY = (0.5, 1.5)


def timed(
    source: Path, streams: Streams, options: ImportOptions
) -> tuple[dict[str, list[StreamFrame]], list[str]]:
    """Return the pictures of each stream with their times, in the order of writing, and remarks."""
    notes: list[str] = []
    result = {"depth": list(streams.depth)}
    if streams.color is not None:
        result["color"] = list(streams.color)
    elif options.color_offset_s is not None:
        raise InvalidConfigError("--color-offset-s: there is no color; leave it out")
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
    if shift_ns := round((options.color_offset_s or 0.0) * 1e9):
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
    missing = [k for k, frame in enumerate(frames) if not frame.stamped]
    if not missing or len(missing) == len(frames):
        return frames
    if missing == [0] and frames[1].time_ns < _LEAST_JUMP_NS:
        return [replace(frames[0], time_ns=0), *frames[1:]]  # a simulator's clock begins at 0
    late_ns = _late_ns(frames) or 0
    notes.append(
        f"{len(missing)} pictures of {name} have no time stamp (the first is number {missing[0]}, "
        f"the last {missing[-1]}); their times of writing stand for them"
    )
    return [one if one.stamped else replace(one, time_ns=one.time_ns - late_ns) for one in frames]


def _late_ns(frames: Sequence[StreamFrame]) -> int | None:
    """Return the time of writing minus the stamp [ns], the median; None if none is known."""
    late = [f.written_ns - f.time_ns for f in frames if f.stamped and f.written_ns is not None]
    return int(np.median(late)) if late else None


def _check_order(source: Path, name: str, frames: Sequence[StreamFrame]) -> None:
    # A message that was recorded twice has its stamp and its time of writing twice.
    frames = list({(frame.time_ns, frame.written_ns or k): frame
                   for k, frame in enumerate(frames)}.values())  # fmt: skip
    times = _times(frames)
    steps = np.diff(times, prepend=times[:1])
    if not (steps > 0).any():
        return
    step, ranked = float(np.median(steps[steps > 0])), np.sort(times)
    latest, (low, high) = np.maximum.accumulate(times), _SAME_DENSITY
    within = np.searchsorted(ranked, latest, side="right") - np.searchsorted(ranked, times)
    density = within / ((latest - times) / step + 1)
    falls = (steps < 0) & (latest - times > 1.5 * step)
    wrong = np.flatnonzero(falls & ((density < low) | (density > high)))
    if len(wrong):
        here, before = int(wrong[0]), int(np.argmax(times[: wrong[0]]))
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
    written = {frame.written_ns for frame in frames}
    return None not in written and len(written) > 0.9 * len(frames)


def _clocks(
    source: Path, depth: Sequence[StreamFrame], name: str, frames: Sequence[StreamFrame]
) -> list[str]:
    """Return remarks on another stream's clock, by the times of writing; refuse a second clock."""
    late, other = _late_ns(depth), _late_ns(frames)
    if late is None or other is None:
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
    fifths = [(one, len(one) // 5) for one in (depth, frames)]
    parts = [part for one, count in fifths for part in (one[:count], one[-count:])]
    ends = [delay for part in parts if (delay := _late_ns(part)) is not None]
    if min(count for _, count in fifths) > 1 and len(ends) == len(parts):
        drift = ends[3] - ends[2] - (ends[1] - ends[0])
        if abs(drift) > _DRIFT_NS:
            return [f"the clock of {name} drifts by {drift / 1e9:.3f} s against that of depth; "
                    "give --stamps written"]  # fmt: skip
    if abs(apart) > _LATE_NS:
        return [f"by the times of writing, the stamps of {name} are {words} of those of depth; if "
                f"it has a clock of its own, {remedy}"]  # fmt: skip
    return []


def _jumps(
    name: str, frames: Sequence[StreamFrame], told: list[tuple[int, int]], options: ImportOptions
) -> list[str]:
    """Return a remark on each jump of the times; `told` has those of the streams before."""
    if len(frames) < 3:
        return []
    order = sorted(range(len(frames)), key=lambda number: frames[number].time_ns)
    times = _times(frames)[order]
    steps, notes = np.diff(times), list[str]()
    written = np.diff([frames[number].written_ns or 0 for number in order])
    usual = float(np.median(steps[steps > 0])) if steps.any() else 1.0
    if steps.any() and not _SLOWEST_NS > usual > _FASTEST_NS:
        rate = f"{1e9 / usual:.3g} pictures of {name} per second"
        notes.append(f"{rate}: check the unit of their times")
    jumps = steps > max(_JUMP_STEPS * usual, _LEAST_JUMP_NS)
    if usable := options.stamps == "header" and _is_usable(frames):
        jumps |= (steps > 3 * usual) & (np.abs(steps - written) > _LATE_NS)
    for k in np.flatnonzero(jumps).tolist():
        start, stop = int(times[k]), int(times[k + 1])
        if any(start < end and begin < stop for begin, end in told):
            continue
        told.append((start, stop))
        remedy = "cut the source there if a clock was set; a pause may stay (`track` simulates 2 s)"
        if usable and written[k] < steps[k] / 2:
            apart = f"{written[k] / 1e9:.3f} s apart"
            remedy = f"a clock was set: they were written {apart}; give --stamps written"
        notes.append(
            f"the times of {name} jump from {start / 1e9:.3f} to {stop / 1e9:.3f} s, by "
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
    """Pair depth and color by time: each the other's nearest, within the tolerance."""
    if not depth:
        raise InvalidRecordingError(f"{path}: not one whole depth picture; record it again")
    ordered = sorted(depth, key=lambda frame: frame.time_ns)
    single = [one for k, one in enumerate(ordered) if not k or one.time_ns > ordered[k - 1].time_ns]
    doubles, times = len(ordered) - len(single), _times(single)
    tolerance = float(np.median(np.diff(times))) / 2 if len(times) > 1 else _LONE_TOLERANCE_NS
    if options.tolerance_s is not None:
        tolerance = options.tolerance_s * 1e9
    if color is None:
        pairs = tuple(Pair(frame, None) for frame in single)
        return Pairing(pairs, tolerance / 1e9, 0, 0, doubles, 0.0)
    if not color:
        raise InvalidRecordingError(f"{path}: not one whole color picture; give --without-color")
    others = sorted(color, key=lambda frame: frame.time_ns)
    other_times = _times(others)
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
    pairs = tuple(Pair(single[k], others[mine[k]]) for k in chosen.tolist())
    alone, worst_s = (len(single) - len(pairs), len(others) - len(pairs)), apart[chosen].max() / 1e9
    return Pairing(pairs, tolerance / 1e9, *alone, doubles, float(worst_s), advice)


def _advice(apart: np.ndarray) -> str:
    """Return the flag that includes half of the pairs that are too far apart [ns], and its cost."""
    if not len(apart):
        return ""
    tolerance_ms = float(np.ceil(np.median(apart) / 1e6 + 0.5))
    if tolerance_ms > 1e3 * LARGEST_TOLERANCE_S:
        return ""
    count = int((apart <= tolerance_ms * 1e6).sum())
    more = f"{count} frame{'s' * (count > 1)} more, if nothing moves much in {tolerance_ms:.0f} ms"
    return f"--tolerance-s {tolerance_ms / 1e3:.3f} for {more}"


def _nearest(times: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the index of the nearest of `others` (sorted) for each time."""
    after = np.searchsorted(others, times).clip(1, max(len(others) - 1, 1))
    if len(others) == 1:
        return np.zeros(len(times), dtype=int)
    return np.where(times - others[after - 1] <= others[after] - times, after - 1, after)
