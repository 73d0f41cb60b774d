"""Numbered points of the cloth in one picture, with the neighbors of each."""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.spatial import cKDTree

NEIGHBORS = 8
"""Number of neighbors that decide whether a point was followed correctly."""

_STRETCH = 1.1, 0.004
"""Points farther apart than this multiple of their earlier distance plus this slack [m] are too far
apart, because cloth hardly stretches."""

NOBODY = -1
"""Stands for a missing neighbor."""


@dataclass(frozen=True, eq=False)
class NumberedPoints:
    """Points in one picture, in the order of their numbers.

    Attributes:
        pixels: their places in the picture [pixels].
        steps: their motion since the previous picture [pixels].
        beside: numbers of each one's neighbors when points were last chosen, or `NOBODY`.
        apart_m: distances to those neighbors at that time [m].
    """

    numbers: Int[np.ndarray, " points"]
    pixels: Float32[np.ndarray, "points 2"]
    steps: Float32[np.ndarray, "points 2"]
    beside: Int[np.ndarray, "points neighbors"]
    apart_m: Float[np.ndarray, "points neighbors"]

    @classmethod
    def fresh(
        cls, numbers: Int[np.ndarray, " points"], pixels: Float32[np.ndarray, "points 2"]
    ) -> "NumberedPoints":
        """Return points that have not moved yet and have no neighbors."""
        nobody = np.full((len(numbers), NEIGHBORS), NOBODY)
        points = cls(numbers, pixels, np.zeros_like(pixels), nobody, np.zeros(nobody.shape))
        return points[np.argsort(numbers)]

    @classmethod
    def none(cls) -> "NumberedPoints":
        """Return an empty set of points."""
        return cls.fresh(np.zeros(0, np.int64), np.zeros((0, 2), np.float32))

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.numbers)

    def __getitem__(
        self, part: Bool[np.ndarray, " points"] | Int[np.ndarray, " part"]
    ) -> "NumberedPoints":
        """Return a part of the points."""
        return NumberedPoints(*(getattr(self, each.name)[part] for each in fields(self)))

    def at(self, pixels: Float32[np.ndarray, "points 2"]) -> "NumberedPoints":
        """Return the same points at their places in the next picture."""
        return replace(self, pixels=pixels, steps=pixels - self.pixels)

    def are_in(self, others: "NumberedPoints") -> Bool[np.ndarray, " points"]:
        """Return which of them are among others."""
        return np.isin(self.numbers, others.numbers)

    def together_with(self, others: "NumberedPoints") -> "NumberedPoints":
        """Return these and other points; the two sets must be disjoint."""
        pairs = ((getattr(self, each.name), getattr(others, each.name)) for each in fields(self))
        both = NumberedPoints(*(np.concatenate(pair) for pair in pairs))
        return both[np.argsort(both.numbers)]

    def with_neighbors(self, positions: Float[np.ndarray, "points 3"]) -> "NumberedPoints":
        """Return the same with the nearest neighbors of each at these positions [m]."""
        if not len(self):
            return self
        apart, place = cKDTree(positions).query(positions, k=NEIGHBORS + 1)
        # Stored by number, because places change when points are lost.
        beside = np.append(self.numbers, NOBODY)[place[:, 1:]]
        return replace(self, beside=beside, apart_m=apart[:, 1:])

    def near_each_other(
        self, positions: Float[np.ndarray, "points 3"]
    ) -> Bool[np.ndarray, " points"]:
        """Return whether each is near most of its remaining neighbors at these positions [m]."""
        if not len(self):
            return np.zeros(0, dtype=bool)
        place = np.minimum(np.searchsorted(self.numbers, self.beside), len(self) - 1)
        followed = self.numbers[place] == self.beside
        apart = np.linalg.norm(positions[place] - positions[:, None], axis=2)
        ratio, slack = _STRETCH
        too_far = followed & (apart > ratio * self.apart_m + slack)
        return too_far.sum(axis=1) <= 0.5 * followed.sum(axis=1)
