"""Detection of pick-and-places from a tip's path, by where it rests low, or by its gap.

Heights are above the table. Frames without the tip are NaN and belong to no visit.
"""

import logging
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from clothtrack.geometry.camera import Camera

logger = logging.getLogger(__name__)

_LEAST_LIFT_M = 0.02
"""Least rise of the tip between pick and place, and before and after them [m]."""
_TOUCH_HEIGHT_M = 0.05
"""Height above the table beyond which a tip touches no cloth [m]."""
_REST_M = 0.004
"""Distance from its lowest point within which a tip counts as resting [m]."""
JUMP_M = 0.04
"""Largest deviation of a position from the line between its neighbors [m]; beyond it is wrong."""
_BORDER_PIXELS = 60.0
"""A tip last seen this near to the picture's border [pixels] has left it; otherwise cloth hides
it."""


def visits_of(
    seen: Bool[np.ndarray, " frames"],
    pixels: Sequence[Float[np.ndarray, " 2"] | None],
    camera: Camera,
) -> list[Int[np.ndarray, " _"]]:
    """Return frames with the tip, split where it leaves the picture (not where it is hidden)."""
    frames = np.flatnonzero(seen)
    edges = np.array([camera.width - 1, camera.height - 1])
    cuts = []
    for place, (before, after) in enumerate(pairwise(frames), start=1):
        last, next_one = pixels[before], pixels[after]
        if after == before + 1 or last is None or next_one is None:
            continue
        rim = min(np.min([pixel, edges - pixel]) for pixel in (last, next_one))
        if rim < _BORDER_PIXELS:
            cuts.append(place)
    return np.split(frames, cuts)


def without_jumps(
    positions: Float[np.ndarray, "frames 3"],
) -> Float[np.ndarray, "frames 3"]:
    """Return the path with single positions far off their neighbors' line set to NaN."""
    kept = positions.copy()
    before, here, after = positions[:-2], positions[1:-1], positions[2:]
    off = np.linalg.norm(here - 0.5 * (before + after), axis=1)
    # A real tip that turns fast also deviates, but by no more than its neighbors are apart.
    apart = np.linalg.norm(after - before, axis=1)
    kept[1:-1][off > JUMP_M + apart] = np.nan
    return kept


def closed_by_rest(
    positions: Float[np.ndarray, "frames 3"],
    heights: Float[np.ndarray, " frames"],
    visits: Sequence[Int[np.ndarray, " _"]],
) -> list[tuple[int, int]]:
    """Return first and last frame of every hold, detected where the tip rests low.

    Args:
        positions: positions of the tip [m]; NaN where it is not seen.
        heights: heights above the table [m].
    """
    spans = []
    for visit in visits:
        lows = _low_points(heights[visit])
        touched = [int(visit[low]) for low in lows if heights[visit[low]] < _TOUCH_HEIGHT_M]
        if len(touched) % 2:
            logger.warning(
                "frames %d to %d: the tip comes down %d times (frames %s), not in pairs of pick "
                "and place; the last time is left out",
                visit[0], visit[-1], len(touched), ", ".join(map(str, touched)),
            )  # fmt: skip
        for pick, place in zip(touched[::2], touched[1::2], strict=False):
            rests = [_rest(positions, visit, low) for low in (pick, place)]
            spans.append((rests[0][0], rests[1][1]))
    return spans


def closed_by_gap(
    gaps: Float[np.ndarray, " frames"],
    heights: Float[np.ndarray, " frames"],
    visits: Sequence[Int[np.ndarray, " _"]],
) -> list[tuple[int, int]]:
    """Return first and last frame of every hold, detected from the gap of the tweezers.

    Args:
        gaps: gaps between the arms [m]; NaN where the tip is not seen.
        heights: heights above the table [m].
    """
    shown = gaps[np.isfinite(gaps)]
    limit = 0.5 * float(np.percentile(shown, 5) + np.percentile(shown, 95))
    spans = []
    for visit in visits:
        # Use the median of three frames, so that one frame with a hidden arm does not count as
        # closed.
        wide = np.pad(gaps[visit], 1, mode="edge")
        shut = np.median(np.stack([wide[:-2], wide[1:-1], wide[2:]]), axis=0) < limit
        changes = np.flatnonzero(np.diff(np.concatenate([[False], shut, [False]])))
        for start, stop in zip(changes[::2], changes[1::2], strict=True):
            # Tweezers that close in the air hold nothing. If they stay closed until they leave the
            # picture, they hold until then.
            down = heights[visit[start]] < _TOUCH_HEIGHT_M
            if down and np.ptp(heights[visit[start:stop]]) > _LEAST_LIFT_M:
                spans.append((int(visit[start]), int(visit[min(stop, len(visit) - 1)])))
    return spans


def _low_points(heights: Float[np.ndarray, " frames"]) -> list[int]:
    """Return the indices of minima between rises and falls of at least `_LEAST_LIFT_M`."""
    lows: list[int] = []
    lowest, highest, falling = 0, 0, True
    for place, height in enumerate(heights):
        if falling:
            if height < heights[lowest]:
                lowest = place
            elif height > heights[lowest] + _LEAST_LIFT_M:
                lows.append(lowest)
                highest, falling = place, False
        elif height > heights[highest]:
            highest = place
        elif height < heights[highest] - _LEAST_LIFT_M:
            lowest, falling = place, True
    # The tip may leave the picture, or the recording may end, right after the last minimum.
    return [*lows, lowest] if falling and len(heights) else lows


def _rest(
    positions: Float[np.ndarray, "frames 3"], visit: Int[np.ndarray, " _"], low: int
) -> tuple[int, int]:
    """Return first and last frame of the visit around `low` that stay within `_REST_M` of it."""
    near = np.linalg.norm(positions[visit] - positions[low], axis=1) <= _REST_M
    first = last = int(np.searchsorted(visit, low))
    while first > 0 and near[first - 1]:
        first -= 1
    while last < len(visit) - 1 and near[last + 1]:
        last += 1
    return int(visit[first]), int(visit[last])
