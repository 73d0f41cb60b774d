"""Recognition of points of a print that were lost under a tool, in a fold or in fast motion.

The surroundings of a point get a description that turning, moving and lighting the cloth hardly
change (D. Lowe, "Distinctive image features from scale-invariant keypoints",
doi:10.1023/B:VISI.0000029664.99615.94; OpenCV's SIFT), and that is searched in later pictures. A
weave looks alike everywhere, and is not recognized.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8
from scipy.spatial import cKDTree

from clothtrack.recordings.numbered_points import NEIGHBORS, too_far_apart

_CONTRAST = 0.02
"""OpenCV's contrast threshold of a key point: half its default, for prints in poor light."""

_UNLIKE_OTHERS = 150.0
"""Least distance of a description to the nearest other one in its picture. Nine in ten of a print
lie 230 and more apart, nine in ten of a weave less than 100; a description's length is 512."""

_DISTINCT = 0.8
"""Largest ratio of a description's distances to its match and to the second best (Lowe)."""

_TOO_FAR = 0.25
"""Largest share of a point's neighbors that may be too far away: where a part of the print is
elsewhere, half of them are nearer than they were."""

LEAST_RECOGNIZED = 30
"""Cloth with fewer key points in the first picture has no print. Fewer points recognized together
may match by chance, because folds look like a print, too."""


@dataclass(frozen=True, eq=False)
class KeyPoints:
    """Points of one picture with distinctive surroundings.

    Attributes:
        pixels: where they are [pixels].
        descriptions: one row each.
    """

    pixels: Float32[np.ndarray, "points 2"]
    descriptions: Float32[np.ndarray, "points 128"]

    @classmethod
    def of(
        cls, gray: UInt8[np.ndarray, "height width"], where: Bool[np.ndarray, "height width"]
    ) -> "KeyPoints":
        """Return the key points in the marked part of a gray picture that look like no other."""
        sift = cv2.SIFT_create(contrastThreshold=_CONTRAST)
        found, descriptions = sift.detectAndCompute(gray, where.view(np.uint8))
        if descriptions is None:
            return cls(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.float32))
        pixels = np.array([point.pt for point in found], np.float32)
        # A point that has two directions is found twice.
        single = np.sort(np.unique(pixels, axis=0, return_index=True)[1])
        points = cls(pixels[single], descriptions[single])
        return points[_unlike_others(points.descriptions)]

    def __getitem__(self, part: Bool[np.ndarray, " points"]) -> "KeyPoints":
        """Return a part of the points."""
        return KeyPoints(self.pixels[part], self.descriptions[part])

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.pixels)


_MOST_VIEWS = 12
"""Most pictures that are remembered, one per action; each search goes through all of them."""


@dataclass(frozen=True, eq=False)
class _Remembered:
    """The key points of the cloth in one picture."""

    numbers: Int[np.ndarray, " points"]
    descriptions: Float32[np.ndarray, "points 128"]
    positions: Float[np.ndarray, "points 3"]


class Recognizer:
    """A memory of numbered key points that finds them again."""

    def __init__(self) -> None:
        """Begin with nothing remembered."""
        self._views: list[_Remembered] = []

    @property
    def sees_print(self) -> bool:
        """Whether the first picture that was remembered, if any, had enough to recognize."""
        return not self._views or len(self._views[0].numbers) >= LEAST_RECOGNIZED

    def knows(self, numbers: Int[np.ndarray, " points"]) -> Bool[np.ndarray, " points"]:
        """Return whether each number is remembered."""
        return np.isin(numbers, np.concatenate([np.zeros(0), *(v.numbers for v in self._views)]))

    def remember(
        self,
        numbers: Int[np.ndarray, " points"],
        seen: KeyPoints,
        positions: Float[np.ndarray, "points 3"],
    ) -> None:
        """Remember key points of a picture under these numbers, where they are in the world [m].

        The first picture is never forgotten; of later ones the oldest is.
        """
        self._views.append(_Remembered(numbers, seen.descriptions, positions))
        if len(self._views) > _MOST_VIEWS:
            del self._views[1]

    def recognized(
        self, seen: KeyPoints, positions: Float[np.ndarray, "points 3"]
    ) -> Int[np.ndarray, " points"]:
        """Return the number of each key point that is seen at these positions [m]; -1 if new.

        The oldest memory is searched first, because its numbers carry the most information.
        """
        numbers = np.full(len(seen), -1)
        for view in self._views:
            place, remembered = _matches(seen.descriptions, view.descriptions)
            near = _stay_together(positions[place], view.positions[remembered])
            place, remembered = place[near], remembered[near]
            if len(place) >= LEAST_RECOGNIZED:
                fresh = numbers[place] < 0
                numbers[place[fresh]] = view.numbers[remembered[fresh]]
        return numbers


def _unlike_others(
    descriptions: Float32[np.ndarray, "points 128"],
) -> Bool[np.ndarray, " points"]:
    """Return which of a picture's descriptions are far from all others."""
    if len(descriptions) < 2:
        return np.ones(len(descriptions), dtype=bool)
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(descriptions, descriptions, k=2)
    # The nearest is the description itself, or its twin.
    return np.array([second.distance > _UNLIKE_OTHERS for _, second in pairs])


def _matches(
    seen: Float32[np.ndarray, "seen 128"], remembered: Float32[np.ndarray, "remembered 128"]
) -> tuple[Int[np.ndarray, " matches"], Int[np.ndarray, " matches"]]:
    """Return pairs of descriptions that are each other's nearest, and distinctly so."""
    nothing = np.zeros(0, np.int64)
    if len(seen) < 2 or len(remembered) < 2:
        return nothing, nothing
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    back = {match.queryIdx: match.trainIdx for match in matcher.match(remembered, seen)}
    pairs = [
        (best.queryIdx, best.trainIdx)
        for best, second in matcher.knnMatch(seen, remembered, k=2)
        if best.distance < _DISTINCT * second.distance and back[best.trainIdx] == best.queryIdx
    ]
    return tuple(np.array(pairs, np.int64).reshape(-1, 2).T)  # type: ignore[return-value]


def _stay_together(
    now: Float[np.ndarray, "points 3"],
    before: Float[np.ndarray, "points 3"],
) -> Bool[np.ndarray, " points"]:
    """Return whether each point is still near all but a few of its former neighbors."""
    near = min(NEIGHBORS, len(now) - 1)
    if near < 1:
        return np.zeros(len(now), dtype=bool)
    apart, beside = cKDTree(before).query(before, k=near + 1)
    distance = np.linalg.norm(now[beside] - now[:, None], axis=2)
    return too_far_apart(distance, apart)[:, 1:].mean(axis=1) <= _TOO_FAR
