"""Pick-and-places of a bare hand, from clicks on the grasp and the release."""

import threading
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.recording import PickAndPlace, PickerPath, Recording
from clothtrack_capture.amendment import set_actions
from clothtrack_capture.carried_path import (
    WINDOW_S,
    CarriedPath,
    HighestCloth,
    fitted_path,
    highest_cloth,
)
from clothtrack_capture.cloth_views import SNAP_M, Click, ClothViews

_ALMOST_LEAST = 0.05
_SAME_TIME_S = 1e-6
_REMEMBERED = 64


@dataclass(frozen=True, eq=False)
class ClickedAction:
    """One pick-and-place by hand.

    Attributes:
        pick: click on the cloth at the grasp.
        seen: whether its times and height were fitted to the cloth; otherwise the times are the
            clicked ones and the height is the usual one.
    """

    pick: Click
    place: Click
    path: CarriedPath
    seen: bool


class ClickedPicking:
    """The pick-and-places of one recording, built up click by click.

    The class is thread-safe.
    """

    def __init__(self, recording: Recording, camera: Camera) -> None:
        """Check that the cloth in the recording can be told apart from a hand."""
        self.views = ClothViews(recording, camera)
        self.times = np.array([frame.time_s for frame in recording.frames])
        self._clicks: list[Click] = []
        self._lock = threading.RLock()
        self._action = lru_cache(maxsize=_REMEMBERED)(self._fitted)

    @property
    def clicks(self) -> tuple[Click, ...]:
        """Clicks in order of their frames: pick, place, pick, place and so on."""
        return tuple(self._clicks)

    def add(self, click: Click) -> None:
        """Add the next click: a pick, or the place of the last pick."""
        with self._lock:
            self.views.require(click)
            kind, last = ("place", "pick") if len(self._clicks) % 2 else ("pick", "last place")
            if self._clicks and click.frame <= self._clicks[-1].frame:
                raise InvalidConfigError(
                    f"the {kind} in frame {click.frame} is not after the {last} in frame "
                    f"{self._clicks[-1].frame}; click it in a later frame, or undo the {last}"
                )
            if kind == "pick":
                self._taken_at(click, self._clicks[-1].frame if self._clicks else 0)
            self._clicks.append(click)

    def undo(self) -> None:
        """Remove the last click, if there is one."""
        with self._lock:
            del self._clicks[-1:]

    def actions(self) -> tuple[ClickedAction, ...]:
        """Return the finished pick-and-places, with the path of the hand in each."""
        with self._lock:
            frames = [click.frame for click in self._clicks]
            return tuple(
                self._action(
                    frames[number - 1] if number else None,
                    *self._clicks[number : number + 2],
                    frames[number + 2] if number + 2 < len(frames) else None,
                )
                for number in range(0, len(frames) - 1, 2)
            )

    def keep(self, name: str) -> Recording:
        """Return the recording with the path of a hand, written unless it is in memory."""
        with self._lock:
            if not self._clicks or len(self._clicks) % 2:
                what = "the last pick has no place" if self._clicks else "nothing is clicked yet"
                raise InvalidConfigError(f"{what}; click where the hand takes and lets go")
            clicked = self.actions()
            spans = self._spans(clicked, name)
            text = [
                {"pick": _row(each.pick), "place": _row(each.place), "seen": each.seen}
                for each in clicked
            ]
            return set_actions(
                self.views.recording,
                {name: self._path(clicked, spans)},
                spans,
                provenance={"picker_found": {"by": "clicks", "actions": text}},
            )

    def summary(self, action: ClickedAction) -> dict[str, object]:
        """Return the frames of pick and release of an action, and its lift [mm], for a report."""
        path = action.path
        pick, release = (
            int(np.searchsorted(self.times, time_s - _SAME_TIME_S))
            for time_s in (path.start_s, path.end_s)
        )
        return {
            "pick": pick,
            "release": min(release, len(self.times) - 1),
            "lift_mm": round(1e3 * path.lift_m),
            "seen": action.seen,
        }

    def _fitted(
        self, placed_before: int | None, pick: Click, place: Click, picked_after: int | None
    ) -> ClickedAction:
        """Return the pick-and-place fitted between the previous place and the next pick."""
        table, times = self.views.table, self.times
        first = placed_before or 0
        last = len(times) - 1 if picked_after is None else picked_after
        # At the place the hand still hides the cloth, so look at frames after the hand has left.
        laid = self.views.cloth_at(place, range(place.frame, last + 1))
        ends = self._taken_at(pick, first), self.views.table_at(place) if laid is None else laid
        clicked = CarriedPath(
            *ends, table.normal, float(times[pick.frame]), float(times[place.frame])
        )
        # Between two actions the hand moves from one to the next. Each action gets half of the
        # frames.
        between = (
            float(times[0 if placed_before is None else (first + pick.frame) // 2 + 1]),
            float(times[-1 if picked_after is None else (place.frame + last) // 2]),
        )
        watched = np.flatnonzero(
            (times >= max(clicked.start_s - WINDOW_S, between[0]))
            & (times <= min(clicked.end_s + WINDOW_S, between[1]))
        )
        tops = []
        for index in watched.tolist():
            view = self.views.of(index)
            inner = view.points[view.inner]
            tops.append(highest_cloth(inner, table.heights(inner), *ends, table.normal))
        height_m, along_m = np.array(tops).T
        seen = HighestCloth(times[watched], height_m, along_m)
        heights = table.heights(np.stack(ends)).tolist()
        path = fitted_path(clicked, seen, (heights[0], heights[1]), between)
        return ClickedAction(pick, place, path or clicked, path is not None)

    def _taken_at(self, click: Click, first: int) -> Float[np.ndarray, " 3"]:
        """Return the cloth position at a pick [m], from frames before the hand hides it."""
        point = self.views.cloth_at(click, range(click.frame, first - 1, -1))
        if point is None:
            raise InvalidConfigError(
                f"frame {click.frame}: nothing within {1e3 * SNAP_M:.0f} mm of the pick "
                f"({click.column}, {click.row}) is cloth; click on the cloth where the hand takes "
                "it, or mend the masks (clothtrack segment)"
            )
        return point

    def _spans(self, clicked: tuple[ClickedAction, ...], name: str) -> tuple[PickAndPlace, ...]:
        """Return the actions' frame ranges, cut where the hand hides least."""
        times = self.times
        ends = [times[0], *(each.path.end_s for each in clicked[:-1])]
        starts = [
            self._without_hand(
                np.flatnonzero((times >= end_s) & (times <= each.path.start_s + _SAME_TIME_S))
            )
            for end_s, each in zip(ends, clicked, strict=True)
        ]
        lasts = [*starts[1:], len(times) - 1]
        return tuple(PickAndPlace(*span, (name,)) for span in zip(starts, lasts, strict=True))

    def _without_hand(self, frames: Int[np.ndarray, " frames"]) -> int:
        """Return the last of these frames in which the hand hides almost as little as possible."""
        shares = np.array([self.views.of(int(index)).hand_share for index in frames])
        limit = shares.min() + _ALMOST_LEAST * np.ptp(shares)
        return int(frames[np.flatnonzero(shares <= limit)[-1]])

    def _path(
        self, clicked: tuple[ClickedAction, ...], spans: tuple[PickAndPlace, ...]
    ) -> PickerPath:
        """Return the path, sampled at ends of holds, frames between them and starts of spans."""
        times = self.times
        rows: list[tuple[float, Float[np.ndarray, " 3"], bool]] = []
        for each, span in zip(clicked, spans, strict=True):
            path, begin_s = each.path, float(times[span.first_frame])
            if path.start_s - begin_s > _SAME_TIME_S and (
                not rows or begin_s - rows[-1][0] > _SAME_TIME_S
            ):
                rows.append((begin_s, path.pick, False))
            inside = (times > path.start_s + _SAME_TIME_S) & (times < path.end_s - _SAME_TIME_S)
            held = np.concatenate([[path.start_s], times[inside], [path.end_s]])
            rows += [
                (time_s, position, time_s < path.end_s)
                for time_s, position in zip(held.tolist(), path.positions_at(held), strict=True)
            ]
        if times[-1] - rows[-1][0] > _SAME_TIME_S:
            rows.append((float(times[-1]), rows[-1][1], False))
        samples, positions, closed = zip(*rows, strict=True)
        return PickerPath(np.array(samples), np.stack(positions), np.array(closed))


def _row(click: Click) -> list[int]:
    return [click.frame, click.column, click.row]
