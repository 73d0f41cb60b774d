"""Check of the picker's clock: the lag at which the path of the closed tip fits the moving cloth.

Carried cloth is where the tip is. A tip whose times are late is still in the air when the cloth has
been laid down, and on the table when the cloth is in the air. The path is therefore shifted in
time, and the lag at which it fits the observed cloth best is the clock's error.

Correlating the speeds of tip and cloth was tried: cloth that falls after the release, and cloth
that a tool uncovers, moved the maximum by 0.4 s on right recordings of T-shirts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from clothtrack.recordings.geometry_checks.finding import Finding, ObservedFrames
from clothtrack.recordings.geometry_checks.picker_checks import (
    allowance_m,
    carried_distances_m,
    held_by_name,
)
from clothtrack.recordings.recording import PickerPath, Recording

_LARGEST_LAG_S = 0.2
"""Difference of the two clocks [s] from which they are doubted, at least one and a half frames.
Right recordings are never doubted below `_LEAST_GAIN_M`, whatever their lag."""

FARTHEST_LAG_S = 1.5
"""Largest lag that is tried [s]."""

STEP_S = 0.05
"""Difference between lags that are tried [s]."""

_LEAST_GAIN_M = 0.008
"""Least reduction of the mean distance from the cloth by the lag [m] for a clock to be doubted."""

_LARGEST_REST_M = 0.01
"""Mean distance of the shifted path from the cloth [m] above which no lag explains the path."""

FAR_M = 0.04
"""Distances from the cloth are clipped to this [m], because the tool may hide its own tip."""

LEAST_SHARE = 0.8
"""Share of the closed time that must fall on frames with the lag."""

MOST_FRAMES = 40
"""Number of frames used, spread over the actions; each costs some 30 ms."""


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
        return clear and abs(self.lag_s) > largest_lag_s(times_s)


def largest_lag_s(times_s: Sequence[float]) -> float:
    """Return the largest lag [s] that is not doubted for pictures at these times [s]."""
    return max(_LARGEST_LAG_S, 1.5 * float(np.median(np.diff(times_s))))


def clock_findings(recording: Recording, frames: ObservedFrames) -> list[Finding]:
    """Return a finding if the picker's clock clearly runs before or behind that of the pictures."""
    total_m, count = _beside(recording, frames, np.zeros(1))
    if total_m[0] < _LEAST_GAIN_M * max(count[0], 1.0):
        return []  # No lag can bring the path so much nearer, so none is tried.
    lag = picker_lag(recording, frames)
    if lag is None:
        return []
    times_s = [frame.time_s for frame in recording.frames]
    limit_s = largest_lag_s(times_s)
    if not lag.is_wrong(times_s):
        return []
    order, change = ("before", "subtract") if lag.lag_s < 0 else ("after", "add")
    text = (
        f"the cloth moves {abs(lag.lag_s):.2f} s {order} the closed picker does (at most "
        f"{limit_s:.2f}): write time_s of picker.csv by the clock of the frames, {change} "
        f"{abs(lag.lag_s):.2f} s"
    )
    return [Finding("picker_clock", lag.lag_s, limit_s, "s", "picker.csv: time_s", text)]


def picker_lag(recording: Recording, frames: ObservedFrames) -> ClockLag | None:
    """Return the lag at which the closed tips are nearest to the cloth.

    None if it cannot be found: no action, or only pickers whose held vertices are recorded.
    """
    lags = np.arange(-FARTHEST_LAG_S, FARTHEST_LAG_S + 0.5 * STEP_S, STEP_S)
    total, count = _beside(recording, frames, lags)
    none = int(np.argmin(np.abs(lags)))
    enough = count >= max(LEAST_SHARE * count.max(), 3.0)
    if not enough[none]:
        return None
    mean = np.where(enough, total / np.maximum(count, 1.0), np.inf)
    best = int(np.argmin(mean))
    return ClockLag(float(lags[best]), float(mean[none]), float(mean[best]))


def _beside(
    recording: Recording, frames: ObservedFrames, lags: Float[np.ndarray, " lags"]
) -> tuple[Float[np.ndarray, " lags"], Float[np.ndarray, " lags"]]:
    """Return the sum of the distances of closed tips from the cloth [m], and their number."""
    total, count = np.zeros(len(lags)), np.zeros(len(lags))
    paths = [
        path for name, path in recording.picker_paths.items() if not held_by_name(recording, name)
    ]
    if not recording.actions:
        return total, count
    first, last = recording.actions[0].first_frame, recording.actions[-1].last_frame
    for frame in np.unique(np.linspace(first, last, MOST_FRAMES).round().astype(int)).tolist():
        times = recording.frames[frame].time_s - lags
        for path in paths:
            closed = _closed(path, times)
            seen = frames.at(frame) if closed.any() else None
            if seen is None or not len(seen.points):
                continue
            tips = np.stack([np.interp(times[closed], path.time_s, a) for a in path.positions.T], 1)
            beside = carried_distances_m(seen, tips, allowance_m(recording))
            total[closed] += np.minimum(beside, FAR_M)
            count[closed] += 1.0
    return total, count


def _closed(path: PickerPath, times: Float[np.ndarray, " times"]) -> np.ndarray:
    """Return at which of these times of its own clock a picker is closed."""
    place = np.searchsorted(path.time_s, times + 1e-9, side="right") - 1
    inside = (place >= 0) & (times <= path.time_s[-1])
    return inside & path.closed[np.clip(place, 0, None)]
