"""Which color picture belongs to which depth picture: the nearest in time, each once."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clothtrack.errors import InvalidRecordingError
from clothtrack_capture.importing.source import StreamFrame

_LONE_TOLERANCE_NS = 20e6


@dataclass(frozen=True)
class Pair:
    """A moment: its depth picture and, unless there is no color at all, its color picture."""

    depth: StreamFrame
    color: StreamFrame | None


@dataclass(frozen=True)
class Pairing:
    """The moments of a recording.

    Attributes:
        pairs: in order of time, times strictly increasing.
        tolerance_s: how far apart two pictures of a moment may be [s].
        depth_alone: depth pictures without a color picture near enough.
        color_alone: color pictures without a depth picture.
        doubles: depth pictures with the time of another.
        worst_s: the largest difference between two pictures of a moment [s].
        advice: the tolerance that would take more pictures in, and how many; "" when none would.
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
) -> Pairing:
    """Pair depth and color by time stamp.

    A pair is one of pictures that are each other's nearest and no farther apart than the tolerance.

    Args:
        path: the source, for errors.
        depth: depth pictures in any order.
        color: color pictures in any order, or None when there is no color stream.
        tolerance_s: largest difference [s]; half the time between depth pictures by default.

    Raises:
        InvalidRecordingError: there is no depth picture or no pair at all.
    """
    if not depth:
        raise InvalidRecordingError(
            f"{path}: not one whole depth picture; record it again or name another --depth-topic"
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
    """The flag that takes in half of the pairs that are too far apart [ns], and what it costs.

    Half: a constant offset between two clocks is met, a gap in one of the films is not.
    """
    if not len(apart):
        return ""
    tolerance_ms = float(np.ceil(np.median(apart) / 1e6 + 0.5))
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
