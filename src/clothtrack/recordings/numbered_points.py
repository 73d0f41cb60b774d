"""Points of the cloth in one picture, by number, and which others were beside each."""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.spatial import cKDTree

NEIGHBORS = 8
"""So many points that were beside one say whether it is where it is taken to be."""

_STRETCH = 1.1, 0.004
"""Too far apart is more than so many times the distance before, and so much [m]: cloth hardly
stretches."""

NOBODY = -1
"""Stands for a neighbor that there is not."""


@dataclass(frozen=True, eq=False)
class NumberedPoints:
    """Points in one picture, in the order of their numbers.

    Attributes:
        numbers: which points of the cloth they are.
        pixels: where they are.
        steps: how far they went from the picture before [pixels].
        beside: numbers of those that were beside each where points were last chosen, or `NOBODY`.
        apart_m: how far away those were [m].
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
        """Return points that have not moved yet, with nobody beside them."""
        nobody = np.full((len(numbers), NEIGHBORS), NOBODY)
        points = cls(numbers, pixels, np.zeros_like(pixels), nobody, np.zeros(nobody.shape))
        return points[np.argsort(numbers)]

    @classmethod
    def none(cls) -> "NumberedPoints":
        """No point."""
        return cls.fresh(np.zeros(0, np.int64), np.zeros((0, 2), np.float32))

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.numbers)

    def __getitem__(
        self, part: Bool[np.ndarray, " points"] | Int[np.ndarray, " part"]
    ) -> "NumberedPoints":
        """Return those of a part."""
        return NumberedPoints(*(getattr(self, each.name)[part] for each in fields(self)))

    def at(self, pixels: Float32[np.ndarray, "points 2"]) -> "NumberedPoints":
        """Return the same in the next picture."""
        return replace(self, pixels=pixels, steps=pixels - self.pixels)

    def are_in(self, others: "NumberedPoints") -> Bool[np.ndarray, " points"]:
        """Return which of them are among others."""
        return np.isin(self.numbers, others.numbers)

    def together_with(self, others: "NumberedPoints") -> "NumberedPoints":
        """These and others, none of which is among them."""
        pairs = ((getattr(self, each.name), getattr(others, each.name)) for each in fields(self))
        both = NumberedPoints(*(np.concatenate(pair) for pair in pairs))
        return both[np.argsort(both.numbers)]

    def with_neighbors(
        self, positions: Float[np.ndarray, "points 3"], among: Bool[np.ndarray, " points"]
    ) -> "NumberedPoints":
        """Return the same with those beside each that are nearest here [m].

        Some are asked for only.
        """
        if not among.any():
            return self
        apart, place = cKDTree(positions[among]).query(positions, k=NEIGHBORS + 1)
        # By number, because others will be lost.
        beside = np.append(self.numbers[among], NOBODY)[place[:, 1:]]
        return replace(self, beside=beside, apart_m=apart[:, 1:])

    def near_each_other(
        self, positions: Float[np.ndarray, "points 3"]
    ) -> Bool[np.ndarray, " points"]:
        """Whether each, being here [m], is near most of those beside it that are not lost."""
        if not len(self):
            return np.zeros(0, dtype=bool)
        place = np.minimum(np.searchsorted(self.numbers, self.beside), len(self) - 1)
        followed = self.numbers[place] == self.beside
        apart = np.linalg.norm(positions[place] - positions[:, None], axis=2)
        too_far = followed & too_far_apart(apart, self.apart_m)
        return too_far.sum(axis=1) <= 0.5 * followed.sum(axis=1)


def too_far_apart(
    now: Float[np.ndarray, "points neighbors"], before: Float[np.ndarray, "points neighbors"]
) -> Bool[np.ndarray, "points neighbors"]:
    """Return whether two points are farther apart [m] than cloth can have stretched."""
    ratio, slack = _STRETCH
    return now > ratio * before + slack
