"""The path of an untracked hand: an arc from pick to place, fitted to the cloth that it lifts.

A held cloth is highest at the hand. The highest visible cloth near the straight line from pick to
place therefore rises, moves and comes down with the hand. The start time, end time and height of
the arc are fitted to this cloth.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_USUAL_LIFT_M = 0.08
"""Height of the arc [m] if it cannot be fitted to the cloth."""
WINDOW_S = 0.4
"""Search range for start and end around the clicked frames [s]."""
_CORRIDOR_M = 0.05
"""Cloth within this distance of the line [m], seen from above, can be the held cloth."""
_RISE_M = 0.015
"""Cloth is lifted if it is higher than before and after the action by more than this [m]."""
UNDER_TIP_M = 0.01
"""Distance of the highest visible cloth below the tip [m], because the fingers hide what they
hold."""

_TRIES = 33
_LIFTS_M = np.arange(0.02, 0.26, 0.01)
_STEEPNESSES = (2, 4, 6)
_HIGHEST_POINTS = 20
_LEAST_POINTS = 30
_LEAST_LIFTED_FRAMES = 3
_OFF_AT_MOST_M = 0.02
_BEHIND_AT_MOST_M = 0.04
_CLICK_ERROR_S = 0.15
_CLICK_WORTH_M = 0.0003


@dataclass(frozen=True, eq=False)
class CarriedPath:
    """An arc over the straight line from pick to place, slow at both ends.

    Attributes:
        pick: grasp point on the cloth [m], world.
        place: release point [m], world.
        start_s: time at which the hand begins to rise [s].
        end_s: time at which the hand has come down [s].
        lift_m: height of the arc over the straight line [m].
        steepness: exponent of the arc: 2 for a parabola; with 4 and 6 it rises first, then goes
            across.
    """

    pick: Float[np.ndarray, " 3"]
    place: Float[np.ndarray, " 3"]
    up: Float[np.ndarray, " 3"]
    start_s: float
    end_s: float
    lift_m: float = _USUAL_LIFT_M
    steepness: int = 2

    def positions_at(self, times: Float[np.ndarray, " samples"]) -> Float[np.ndarray, "samples 3"]:
        """Return the hand positions [m], constant before the start and after the end."""
        share = _share_of_way(times, np.array(self.start_s), np.array(self.end_s))
        line = self.pick + share[:, None] * (self.place - self.pick)
        return line + (self.lift_m * _arc(share, self.steepness))[:, None] * self.up


@dataclass(frozen=True, eq=False)
class HighestCloth:
    """The highest visible cloth near the line from pick to place; NaN where none is visible.

    Attributes:
        time_s: time of each frame [s].
        height_m: height above the table [m].
        along_m: distance from the pick towards the place [m], seen from above.
    """

    time_s: Float[np.ndarray, " frames"]
    height_m: Float[np.ndarray, " frames"]
    along_m: Float[np.ndarray, " frames"]


def highest_cloth(
    points: Float[np.ndarray, "points 3"],
    heights: Float[np.ndarray, " points"],
    pick: Float[np.ndarray, " 3"],
    place: Float[np.ndarray, " 3"],
    up: Float[np.ndarray, " 3"],
) -> tuple[float, float]:
    """Return height above the table and distance along the line [m] of the highest cloth near it.

    Args:
        points: cloth points in one frame [m], world.
        heights: heights of the points above the table [m].
    """
    forward, way_m = _direction(pick, place, up)
    along = (points - pick) @ forward
    aside = (points - pick) @ np.cross(up, forward)
    near = (along > -_CORRIDOR_M) & (along < way_m + _CORRIDOR_M) & (np.abs(aside) < _CORRIDOR_M)
    if np.count_nonzero(near) < _LEAST_POINTS:
        return float("nan"), float("nan")
    heights, along = heights[near], along[near]
    # A single point may be noise, so take the median of the highest points.
    top = np.argpartition(heights, -_HIGHEST_POINTS)[-_HIGHEST_POINTS:]
    return float(np.median(heights[top])), float(np.median(along[top]))


def fitted_path(
    clicked: CarriedPath,
    seen: HighestCloth,
    heights_m: tuple[float, float],
    between_s: tuple[float, float],
) -> CarriedPath | None:
    """Return the arc whose times and height fit the highest cloth best.

    Cloth above the arc costs more than cloth below it, because cloth hangs.

    Args:
        heights_m: heights of pick and place above the table [m].
        between_s: earliest start and latest end of the hand's motion [s].
    """
    height, known = seen.height_m, np.isfinite(seen.height_m)
    before = _typical(height[known & (seen.time_s < clicked.start_s - 0.5 * _CLICK_ERROR_S)])
    after = _typical(height[known & (seen.time_s > clicked.end_s + 0.5 * _CLICK_ERROR_S)])
    before, after = (after if before is None else before), (before if after is None else after)
    if before is None or after is None:
        return None
    span = clicked.start_s, clicked.end_s
    lifted = known & (height > np.interp(seen.time_s, span, (before, after)) + _RISE_M)
    if np.count_nonzero(lifted) < _LEAST_LIFTED_FRAMES:
        return None
    starts, ends = _candidate_times(clicked, between_s)
    _, way_m = _direction(clicked.pick, clicked.place, clicked.up)
    share = _share_of_way(seen.time_s, starts[:, None], ends[:, None])
    resting = before + (after - before) * share
    line = heights_m[0] + (heights_m[1] - heights_m[0]) * share
    behind = np.minimum(np.abs(seen.along_m - share * way_m), _BEHIND_AT_MOST_M)
    distrust = ((starts - clicked.start_s) ** 2 + (ends - clicked.end_s) ** 2) / _CLICK_ERROR_S**2
    fixed = _mean_square(0.5 * behind, lifted) + _CLICK_WORTH_M**2 * distrust
    best, chosen = np.inf, None
    for steepness in _STEEPNESSES:
        arc = _arc(share, steepness)
        for lift_m in _LIFTS_M.tolist():
            off = height - np.maximum(resting, line + lift_m * arc - UNDER_TIP_M)
            off = np.minimum(np.where(off > 0.0, off, -0.5 * off), _OFF_AT_MOST_M)
            cost = fixed + _mean_square(off, known)
            least = int(np.argmin(cost))
            if cost[least] < best:
                best = float(cost[least])
                chosen = float(starts[least]), float(ends[least]), lift_m, steepness
    assert chosen is not None
    return CarriedPath(clicked.pick, clicked.place, clicked.up, *chosen)


def _direction(
    pick: Float[np.ndarray, " 3"], place: Float[np.ndarray, " 3"], up: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, " 3"], float]:
    """Return the unit vector along the table from pick to place, and their distance [m]."""
    flat = (place - pick) - ((place - pick) @ up) * up
    way_m = float(np.linalg.norm(flat))
    if way_m < 1e-3:
        # Pick and place coincide, so any direction along the table will do.
        flat = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    return flat / np.linalg.norm(flat), way_m


def _candidate_times(
    clicked: CarriedPath, between_s: tuple[float, float]
) -> tuple[Float[np.ndarray, " candidates"], Float[np.ndarray, " candidates"]]:
    """Return start and end times near the clicked ones, at least half of their interval apart."""
    tried = np.linspace(-WINDOW_S, WINDOW_S, _TRIES)
    pairs = np.meshgrid(clicked.start_s + tried, clicked.end_s + tried, indexing="ij")
    starts, ends = (np.clip(times.ravel(), *between_s) for times in pairs)
    apart = ends - starts >= 0.5 * (clicked.end_s - clicked.start_s)
    return starts[apart], ends[apart]


def _share_of_way(
    times: Float[np.ndarray, "*any"], start_s: np.ndarray, end_s: np.ndarray
) -> np.ndarray:
    """Return the share of the path covered at each time, with a minimum-jerk profile."""
    share = np.clip((times - start_s) / (end_s - start_s), 0.0, 1.0)
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def _arc(share: np.ndarray, steepness: int) -> np.ndarray:
    return 1.0 - (2.0 * share - 1.0) ** steepness


def _typical(values: Float[np.ndarray, " values"]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _mean_square(values: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Return the mean square over all frames; frames that are not counted contribute 0."""
    return np.where(counted, values**2, 0.0).mean(axis=-1)
