"""Pairing of color and depth pictures that are nearest in time, each used at most once."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clothtrack.errors import InvalidRecordingError
from clothtrack_capture.importing.source import StreamFrame

LARGEST_TOLERANCE_S = 1.0
_LONE_TOLERANCE_NS = 20e6


@dataclass(frozen=True)
class Pair:
    """A depth picture and its color picture, or None if there is no color stream."""

    depth: StreamFrame
    color: StreamFrame | None


@dataclass(frozen=True)
class Pairing:
    """The paired pictures of a recording.

    Attributes:
        pairs: pairs in order of time, with strictly increasing times.
        tolerance_s: largest allowed time difference between the two pictures of a pair [s].
        depth_alone: number of depth pictures without a color picture near enough.
        color_alone: number of color pictures without a depth picture.
        doubles: number of depth pictures with the same time as another.
        worst_s: largest time difference within a pair [s].
        advice: tolerance that would include more pictures, and how many; "" if none would.
    """

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
    tolerance_s: float | None,
    *,
    color_offset_s: float = 0.0,
) -> Pairing:
    """Pair depth and color by time: each the other's nearest, within the tolerance.

    Args:
        path: path of the source, for error messages.
        depth: depth pictures in any order.
        color: color pictures in any order, or None if there is no color stream.
        tolerance_s: largest time difference [s]; half the time between depth pictures by default.
        color_offset_s: what the user had added to the stamps of color [s].
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
    tolerance = _tolerance_ns(times, tolerance_s)
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
            offset_s = color_offset_s + (int(times[0]) - int(other_times[0])) / 1e9
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
