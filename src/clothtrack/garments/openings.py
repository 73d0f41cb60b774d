"""Openings of a flat garment: detected on its outline, or marked by a person.

Landmarks are indices of the outline's points. A garment is upright here: neck or waist toward +y,
its line of symmetry at x = 0, its outline counterclockwise.
"""

from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.garments.silhouettes import Outline, Silhouette, mirror_axis, symmetric

SewnKind = Literal["tshirt", "polo", "sweater", "trousers"]
"""Garments of two layers."""

_SHIRT_STRETCHES = ("hem", "side", "cuff", "shoulder", "neck", "shoulder", "cuff", "side")
_TROUSERS_STRETCHES = ("waist", "outer seam", "cuff", "inner seam", "cuff", "outer seam")
"""Stretches of an outline, counterclockwise; each begins where the previous one ends."""

OPENINGS = ("hem", "cuff", "neck", "waist")
"""Stretches where front and back are not sewn together."""

CORNER_SHARE = 0.012
"""A bend that deviates from a straight line by this share of the garment's extent is a corner."""

_SNAP_SHARE = 0.025
"""Landmarks snap to a corner that is nearer than this share of the garment's extent."""

_NOTCH_SHARE = 0.015
"""A notch smaller than this share of the garment's extent is neither an armpit nor a crotch."""

_NECK_DIP_SHARE = 0.008
"""A neckline shallower than this share of the garment's length cannot be distinguished from
noise."""

_USUAL_NECK_SHARE = 0.28
"""Width of a neck that is not detected, as a share of the width between the armpits."""


@dataclass(frozen=True, eq=False)
class Openings:
    """Upright outline, cut at the ends of its openings.

    Attributes:
        starts: index of the first point of every stretch.
        names: name of each stretch, as in `_SHIRT_STRETCHES`.
        neck_seen: whether the neck's ends were detected rather than guessed.
    """

    outline: Silhouette
    starts: tuple[int, ...]
    names: tuple[str, ...]
    neck_seen: bool = True

    def stretch(self, number: int) -> Outline:
        """Return the points [m] of a stretch, both ends included."""
        return _between(self.outline.points, self.starts[number], self._end(number))

    def stretch_pixels(self, number: int) -> Outline:
        """Return the same points in the picture."""
        return _between(self.outline.pixels, self.starts[number], self._end(number))

    def _end(self, number: int) -> int:
        return self.starts[(number + 1) % len(self.starts)]


def find_openings(outline: Silhouette, kind: SewnKind, name: str = "the picture") -> Openings:
    """Rotate a flat garment upright and find its openings."""
    angle, through = mirror_axis(outline.points)
    centered = outline.shifted(-through)
    search = _trousers_landmarks if kind == "trousers" else _shirt_landmarks
    candidates = []
    for turn in (angle, angle + np.pi):
        upright = centered.upright(turn)
        landmarks = search(symmetric(upright.points))
        if landmarks is not None:
            candidates.append((landmarks.clarity, upright, landmarks))
    if not candidates:
        notch = "the legs" if kind == "trousers" else "sleeves and body"
        raise InvalidRecordingError(
            f"{name}: this is not the outline of a flat {kind}: there is no gap between {notch}; "
            "lay it out again with a gap there, check --kind, or point at the ends of its openings "
            "with --openings"
        )
    _, upright, landmarks = max(candidates, key=lambda candidate: candidate[0])
    right = landmarks.places
    left = right[::-1] * (-1.0, 1.0)
    if kind == "trousers":
        names, ends = _TROUSERS_STRETCHES, np.concatenate([right[2:], left, right[:2]])
    else:
        names, ends = _SHIRT_STRETCHES, np.concatenate([left[3:], right, left[:3]])
    starts = _snapped(upright.points, ends)
    if not _once_around(starts, len(upright.points)):
        raise InvalidRecordingError(
            f"{name}: the halves of the {kind} differ too much to find its openings; lay it out "
            "again, or point at their ends with --openings"
        )
    return Openings(upright, tuple(starts), names, neck_seen=landmarks.neck_seen)


def openings_at(
    outline: Silhouette, kind: SewnKind, pixels: Float[np.ndarray, "ends 2"]
) -> Openings:
    """Return openings whose ends a person has marked."""
    names = _TROUSERS_STRETCHES if kind == "trousers" else _SHIRT_STRETCHES
    wanted = 2 * sum(name in OPENINGS for name in names)
    if pixels.shape != (wanted, 2):
        order = "waist, cuff, cuff" if kind == "trousers" else "hem, cuff, neck, cuff"
        raise InvalidConfigError(
            f"--openings has {len(pixels)} places; a {kind} needs {wanted}: both ends of "
            f"{order}, in this order around the garment"
        )
    apart = np.linalg.norm(outline.pixels[None] - pixels[:, None], axis=2)
    ends = [int(index) for index in apart.argmin(axis=1)]
    count = len(outline.points)
    if not _once_around(ends, count):
        ends = ends[1::-1] + ends[:1:-1]
    if not _once_around(ends, count):
        raise InvalidConfigError(
            f"--openings are not in order around the garment: {pixels.tolist()}; go once around "
            "it, naming both ends of each opening"
        )
    top, bottom = (ends[:2], ends[2:]) if kind == "trousers" else (ends[4:6], ends[:2])
    up = outline.points[top].mean(axis=0) - outline.points[bottom].mean(axis=0)
    upright = outline.upright(float(np.arctan2(up[1], up[0])))
    return Openings(upright, tuple(ends), names)


@dataclass(frozen=True, eq=False)
class _Landmarks:
    """Ends of the openings on the right half [m], from bottom to top, and their clarity."""

    places: Outline
    clarity: float
    neck_seen: bool = True


def _shirt_landmarks(upright: Outline) -> _Landmarks | None:
    """Find the hem, both ends of the cuff, and the neck of a symmetric outline."""
    points = _right_half(upright)
    if points is None:
        return None
    depth, armpit = _deepest_notch(points)
    extent = float(np.ptp(upright, axis=0).max())
    if depth < _NOTCH_SHARE * extent:
        return None
    hem = _farthest_from_chord(points, 0, armpit)
    neck, seen = _neck(points, armpit)
    cuff = _cuff(points[armpit : neck + 1], CORNER_SHARE * extent)
    if cuff is None:
        return None
    low, high = armpit + cuff[0], armpit + cuff[1]
    if not hem < armpit <= low < high < neck:
        return None
    # The notch opens toward the hem.
    opens = points[armpit, 1] - (points[hem, 1] + points[armpit, 1] + points[low, 1]) / 3.0
    return _Landmarks(points[[hem, low, high, neck]], float(opens) / extent, seen)


def _trousers_landmarks(upright: Outline) -> _Landmarks | None:
    """Find both ends of the cuff, and the waist, of a symmetric outline."""
    points = _right_half(upright)
    if points is None:
        return None
    extent = float(np.ptp(upright, axis=0).max())
    gap = float(points[0, 1] - points[:, 1].min())
    if gap < _NOTCH_SHARE * extent:
        return None
    foot = points[int(points[:, 1].argmin())]
    out = foot - points[0]
    inner, outer = 0, 0
    for _ in range(3):
        out = out / np.linalg.norm(out)
        inner = _extreme(points, _turned(out, -np.pi / 4))
        outer = _extreme(points, _turned(out, np.pi / 4))
        if outer <= inner:
            return None
        across = points[outer] - points[inner]
        out = _turned(across / np.linalg.norm(across), -np.pi / 2)
    waist = outer + _extreme(points[outer:], np.array([np.sqrt(0.5), np.sqrt(0.5)]))
    if not 0 < inner < outer < waist < len(points) - 1:
        return None
    return _Landmarks(points[[inner, outer, waist]], gap / extent)


def _right_half(points: Outline) -> Outline | None:
    """Return the outline from the bottom of the axis x = 0 counterclockwise to its top."""
    x, ahead = points[:, 0], np.roll(points[:, 0], -1)
    rising = np.flatnonzero((x <= 0.0) & (ahead > 0.0))
    falling = np.flatnonzero((x > 0.0) & (ahead <= 0.0))
    if not len(rising) or not len(falling):
        return None
    # If the outline crosses the axis more than twice, use the lowest and the highest crossing.
    start = int(rising[points[rising, 1].argmin()]) + 1
    stop = int(falling[points[falling, 1].argmax()])
    half = _between(points, start, stop)
    return half if len(half) > len(points) // 6 else None


def _deepest_notch(half: Outline) -> tuple[float, int]:
    """Return depth [m] and index of the deepest dent of a half, closed at the axis."""
    # OpenCV expects pixels; it needs integers to keep the hull's order.
    scaled = np.rint((half - half.min(axis=0)) / np.ptp(half, axis=0).max() * 1e6).astype(np.int32)
    hull = np.unique(cv2.convexHull(scaled, returnPoints=False).ravel())
    best = (-np.inf, 0)
    for start, end in pairwise(hull):
        if end - start < 3:
            continue
        along = half[end] - half[start]
        normal = _turned(along / max(float(np.linalg.norm(along)), 1e-12), np.pi / 2)
        depth = (half[start : end + 1] - half[start]) @ normal
        deepest = int(depth.argmax())
        # Skip the dent at the axis, which is the neck and not the armpit.
        if end < len(half) - 1 and depth[deepest] > best[0]:
            best = (float(depth[deepest]), int(start) + deepest)
    return best


def _farthest_from_chord(half: Outline, start: int, end: int) -> int:
    """Return the point farthest to the right of the line from one point to another."""
    along = half[end] - half[start]
    normal = _turned(along, -np.pi / 2)
    return start + int(((half[start : end + 1] - half[start]) @ normal).argmax())


def _cuff(sleeve: Outline, bend_m: float) -> tuple[int, int] | None:
    """Return both ends of the cuff, on the path from the armpit around the sleeve to the neck.

    Any two corners may be the ends of the cuff. The cuff is a straight edge that is perpendicular
    to the sleeve's upper edge, and mostly also to its lower edge, which is very short on a short
    sleeve.
    """
    corners = corners_of(sleeve, bend_m)
    best, best_score = None, 1.0
    for first, last in combinations(corners[:-1], 2):
        across = sleeve[last] - sleeve[first]
        width = float(np.linalg.norm(across))
        out = _turned(across / width, -np.pi / 2)
        bulge = float(np.abs((sleeve[first : last + 1] - sleeve[first]) @ out).max())
        upper = sleeve[last] - sleeve[corners[corners.index(last) + 1]]
        lower = sleeve[first] - sleeve[0]
        below = float(np.linalg.norm(lower))
        score = 2.0 * float(upper @ out) / float(np.linalg.norm(upper)) - 4.0 * bulge / width
        if first > 0:
            score += float(lower @ out) / below * min(1.0, 2.0 * below / width)
        if score > best_score:
            best, best_score = (first, last), score
    return best


def _neck(half: Outline, armpit: int) -> tuple[int, bool]:
    """Return the end of the neck at the shoulder (a default without a dip) and if it was seen."""
    width = 2.0 * float(half[armpit, 0])
    shoulder = int(np.flatnonzero(half[:, 0] > 0.36 * width)[-1])
    rest = half[shoulder:]
    along = rest[-1] - rest[0]
    normal = _turned(along / np.linalg.norm(along), -np.pi / 2)
    height = (rest - rest[0]) @ normal
    peak = int(height.argmax())
    if height[peak] >= _NECK_DIP_SHARE * float(np.ptp(half[:, 1])) and (
        rest[peak, 0] > 0.06 * width
    ):
        return shoulder + peak, True
    beyond = np.flatnonzero(rest[:, 0] > 0.5 * _USUAL_NECK_SHARE * width)
    return shoulder + int(beyond[-1]), False


def corners_of(points: Outline, bend_m: float) -> list[int]:
    """Return indices of an open polyline's corners, both ends included (Douglas-Peucker)."""
    start, end = points[0], points[-1]
    along = end - start
    length = float(np.linalg.norm(along))
    offset = points - start
    if length < 1e-9:
        off = np.linalg.norm(offset, axis=1)
    else:
        off = np.abs(offset[:, 0] * along[1] - offset[:, 1] * along[0]) / length
    worst = int(off.argmax())
    if len(points) < 3 or off[worst] <= bend_m:
        return [0, len(points) - 1]
    after = [worst + index for index in corners_of(points[worst:], bend_m)]
    return [*corners_of(points[: worst + 1], bend_m), *after[1:]]


def _once_around(indices: list[int], count: int) -> bool:
    """Return whether indices of a closed outline are in its order, each once."""
    steps = np.diff([*indices, indices[0]]) % count
    return bool((steps > 0).all() and steps.sum() == count)


def _snapped(outline: Outline, places: Outline) -> list[int]:
    """Return the index of the corner near each place, or of the nearest point without one."""
    reach = _SNAP_SHARE * float(np.ptp(outline, axis=0).max())
    apart = np.linalg.norm(outline[None] - places[:, None], axis=2)
    corners = corners_of(outline, CORNER_SHARE * reach / _SNAP_SHARE)[1:-1]
    snapped = []
    for distances in apart:
        nearest = int(distances.argmin())
        corner = min(corners, key=distances.__getitem__, default=nearest)
        snapped.append(corner if distances[corner] < reach else nearest)
    return snapped


def _extreme(points: Outline, direction: Float[np.ndarray, " 2"]) -> int:
    return int((points @ direction).argmax())


def _turned(vector: Float[np.ndarray, " 2"], angle: float) -> Float[np.ndarray, " 2"]:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1]])


def _between(points: Outline, start: int, end: int) -> Outline:
    count = len(points)
    return points[np.arange(start, start + (end - start) % count + 1) % count]
