"""Joining of depth, color, tip position and gripper state that belong to one moment.

This module does not depend on DDS. Pictures and samples are added with their times, and joined
moments are returned.
"""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidRecordingError

_QUEUED = 8
_COLORS_QUEUED = 16
_SAMPLES_KEPT = 4096
_CLOCKS_DIFFER_NS = 10**9
_STARTED_ANEW_NS = 10**9


class Received(NamedTuple):
    """A received message that is not decoded yet.

    Attributes:
        stamp_ns: time in its header [ns].
        sent_ns: time of sending, on the sender's clock [ns].
        came_s: time of arrival, on the local monotonic clock [s].
    """

    stamp_ns: int
    sent_ns: int
    came_s: float
    data: bytes


@dataclass
class PictureCounts:
    """Counts of depth pictures that were not returned.

    Attributes:
        late: number replaced by a newer picture before they were requested.
        alone: number without a color picture near enough.
    """

    late: int = 0
    alone: int = 0
    damaged: int = 0


class PictureQueue:
    """A queue that pairs depth with color and returns the newest pair, dropping older ones."""

    def __init__(self, topic: str, *, with_color: bool, tolerance_s: float, hold_s: float) -> None:
        """Start empty.

        Args:
            tolerance_s: largest difference of their stamps [s].
            hold_s: how long a picture waits for its color and pose [s].
        """
        self._topic, self._with_color = topic, with_color
        self._tolerance_ns, self._hold_s = round(tolerance_s * 1e9), hold_s
        self._depth: deque[Received] = deque()
        self._color: deque[Received] = deque(maxlen=_COLORS_QUEUED)
        self._last_ns: int | None = None
        self.counts = PictureCounts()

    @property
    def waits(self) -> bool:
        """Whether a depth picture is waiting for its color or pose."""
        return bool(self._depth)

    def add_depth(self, picture: Received) -> None:
        """Add a depth picture."""
        newest = self._depth[-1].stamp_ns if self._depth else self._last_ns
        if newest is not None and picture.stamp_ns <= newest:
            if newest - picture.stamp_ns > _STARTED_ANEW_NS:
                raise InvalidRecordingError(
                    f"{self._topic}: time went back by {(newest - picture.stamp_ns) / 1e9:.1f} s; "
                    "the bag or the simulation was started anew: open the source again"
                )
            return
        self._depth.append(picture)
        if len(self._depth) > _QUEUED:
            self._depth.popleft()
            self.counts.late += 1

    def add_color(self, picture: Received) -> None:
        """Add a color picture."""
        self._color.append(picture)

    def next(
        self, now_s: float, picker_known_ns: int | None
    ) -> tuple[Received, Received | None] | None:
        """Return the newest complete depth picture with its color.

        Args:
            now_s: time on the local monotonic clock [s].
            picker_known_ns: time until which the picker's pose is known [ns]; None to not wait for
                it.
        """
        for place in reversed(range(len(self._depth))):
            depth = self._depth[place]
            over = now_s - depth.came_s >= self._hold_s
            if picker_known_ns is not None and picker_known_ns < depth.stamp_ns and not over:
                continue
            if not self._with_color:
                return self._give_out(place), None
            color = self._color_of(depth.stamp_ns, decided=over)
            if color is not None:
                return self._give_out(place), color
        self._drop_those_alone(now_s)
        return None

    def _color_of(self, stamp_ns: int, *, decided: bool) -> Received | None:
        """Return the nearest color picture; None if there is none or a nearer one may come."""
        if not self._color:
            return None
        nearest = min(self._color, key=lambda picture: abs(picture.stamp_ns - stamp_ns))
        newest_ns = max(picture.stamp_ns for picture in self._color)
        near = abs(nearest.stamp_ns - stamp_ns) <= self._tolerance_ns
        return nearest if near and (decided or newest_ns >= stamp_ns) else None

    def _give_out(self, place: int) -> Received:
        self.counts.late += place
        for _ in range(place):
            self._depth.popleft()
        picture = self._depth.popleft()
        self._last_ns = picture.stamp_ns
        return picture

    def _drop_those_alone(self, now_s: float) -> None:
        while self._with_color and self._depth:
            depth = self._depth[0]
            over = now_s - depth.came_s >= self._hold_s
            if not over or self._color_of(depth.stamp_ns, decided=True) is not None:
                return
            self._last_ns = self._depth.popleft().stamp_ns
            self.counts.alone += 1


class TipTrack:
    """The newest few thousand samples of the tip's position."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, Float[np.ndarray, " 3"]]] = deque(maxlen=_SAMPLES_KEPT)

    @property
    def known_ns(self) -> int:
        """Time of the newest sample [ns]; -1 before the first."""
        return self._samples[-1][0] if self._samples else -1

    def add(self, stamp_ns: int, position: Float[np.ndarray, " 3"]) -> None:
        """Add a position [m]; ignore it if it is not newer than the last."""
        if stamp_ns > self.known_ns:
            self._samples.append((stamp_ns, position))

    def at(self, stamp_ns: int, reach_ns: int) -> Float[np.ndarray, " 3"] | None:
        """Return the position at a time [m], linear between samples and constant beyond the ends.

        Args:
            stamp_ns: time [ns].
            reach_ns: largest distance to a sample in time [ns]; beyond it the result is None.
        """
        after: tuple[int, Float[np.ndarray, " 3"]] | None = None
        for sample in reversed(self._samples):
            if sample[0] <= stamp_ns:
                return _between(sample, after, stamp_ns, reach_ns)
            after = sample
        near = after is not None and after[0] - stamp_ns <= reach_ns
        return after[1] if after is not None and near else None


def _between(
    before: tuple[int, Float[np.ndarray, " 3"]],
    after: tuple[int, Float[np.ndarray, " 3"]] | None,
    stamp_ns: int,
    reach_ns: int,
) -> Float[np.ndarray, " 3"] | None:
    if before[0] == stamp_ns:
        return before[1]
    if after is None:
        return before[1] if stamp_ns - before[0] <= reach_ns else None
    if min(stamp_ns - before[0], after[0] - stamp_ns) > reach_ns:
        return None
    share = (stamp_ns - before[0]) / (after[0] - before[0])
    return before[1] + share * (after[1] - before[1])


class GripTrack:
    """The gripper's state over time."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, bool, bool]] = deque(maxlen=_SAMPLES_KEPT)

    def add(self, time_ns: int, closed: bool, *, stamped: bool) -> None:
        """Add the gripper's state from this time on.

        Args:
            time_ns: time in the header, or the time of sending [ns].
        """
        self._samples.append((time_ns, closed, stamped))

    def at(self, stamp_ns: int, sent_ns: int) -> bool:
        """Return whether the gripper was closed; it counts as open before the first message.

        Args:
            stamp_ns: time in the header of the picture [ns].
            sent_ns: time at which the picture was sent [ns]. Samples without a stamp are compared
                with this time if the pictures have another clock (a replayed bag, a simulation).
        """
        same_clock = abs(sent_ns - stamp_ns) < _CLOCKS_DIFFER_NS
        for time_ns, closed, stamped in reversed(self._samples):
            if time_ns <= (stamp_ns if stamped or same_clock else sent_ns):
                return closed
        return False
