"""When each picture was taken: its time stamp, and what the order and the times of writing say."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.source import StreamFrame

_TWO_CLOCKS_NS = 5e8
"""Difference between depth and color, each stamp against its time of writing, of two clocks."""
_JUMP_STEPS, _LEAST_JUMP_NS = 100, 1e9
"""A step is a jump beyond this many median steps, and beyond this time."""
_SAME_DENSITY = (0.5, 1.5)
"""Pictures per median step between a stamp that falls behind and the latest one, if messages were
only written in another order; a clock that was set back fills that time twice, or not at all."""


def timed(
    source: Path, streams: Mapping[str, Sequence[StreamFrame]], options: ImportOptions
) -> tuple[dict[str, list[StreamFrame]], list[str]]:
    """Return the pictures of each stream with their times, in the order of writing, and remarks."""
    notes: list[str] = []
    result = {name: list(frames) for name, frames in streams.items()}
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
