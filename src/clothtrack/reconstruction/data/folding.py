"""Folds a garment on a table like hands do: choice of line, part and accuracy."""

from typing import Literal, get_args

import numpy as np
from scipy.spatial import cKDTree

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.layers import Layers, Line, Points, axes_of

NeatFold = Literal[
    "fold", "fold_half", "fold_corner", "fold_top", "fold_strips", "fold_sleeves", "roll",
    "turn_over",
]  # fmt: skip
NEAT: tuple[str, ...] = get_args(NeatFold)
"""Neat folds of a stack of cloth; after one, a garment is mostly folded further."""

EXACT = 0.5
"""Share of folds that are made carefully."""

CAREFUL_RAD, CARELESS_RAD = np.radians(0.5), np.radians(4.0)
CAREFUL, CARELESS = 0.004, 0.03
"""Standard deviations of a fold's direction [rad], and of its line over the garment's size."""

_DIAGONAL = 0.6
"""Frequency of diagonal half folds over that of half folds along a side, if the edges align equally
well."""

_FOLDED_PART = (0.12, 0.5)
"""Bounds of the share of vertices beyond the line of a fold anywhere."""

CORNER = (0.08, 0.45)
"""Bounds of the distance of the line of a corner fold from the corner, over the garment's size."""

_TOP_DEPTH = (0.06, 0.5)
"""Bounds of the depth to which upper layers are folded back, over the garment's size."""

_TRIES = 12
"""Number of lines that are tried for a part of the uppermost layers."""

_BODY_ROWS = 0.15
"""Lowest share of a shirt's length, which determines the width of its body."""

_SLEEVES = 1.1
"""Ratio of the whole width to the body's width above which a garment has sleeves."""


class NeatFolds:
    """Folds of one garment, each a function from vertex positions [m] to new positions [m].

    Attributes:
        layers: its layers, with the creases of its folds.
        size_m: longer side of the flat garment [m].
        has_sleeves: whether it is clearly wider than at its lower end.
    """

    def __init__(self, mesh: ClothMesh, thickness_m: float) -> None:
        """Prepare folds of a flat garment; a shirt's neck points to +y.

        Args:
            thickness_m: distance that layers keep [m].
        """
        self.layers = Layers(mesh, thickness_m)
        flat = mesh.vertices[:, :2]
        self.size_m = float(np.ptp(flat, axis=0).max())
        low = flat[:, 1] < flat[:, 1].min() + _BODY_ROWS * np.ptp(flat[:, 1])
        self._body_m = float(np.abs(flat[low, 0]).max())
        self.has_sleeves = bool(np.abs(flat[:, 0]).max() > _SLEEVES * self._body_m)

    def fold(
        self, recipe: NeatFold, points: Points, rng: np.random.Generator
    ) -> tuple[NeatFold, Points]:
        """Fold, roll or turn over; return the recipe used, which may be a fallback, and points."""
        if recipe == "fold_sleeves" and not self.has_sleeves:
            recipe = "fold_strips"
        if recipe == "fold_top":
            if (folded := self.top(points, rng)) is not None:
                return recipe, folded
            recipe = "fold_corner"
        if recipe == "turn_over":
            return recipe, self.layers.turned_over(points)
        way = {
            "fold": self.anywhere, "fold_half": self.half, "fold_corner": self.corner,
            "fold_strips": self.strips, "fold_sleeves": self.sleeves, "roll": self.roll,
        }[recipe]  # fmt: skip
        return recipe, way(points, rng)

    def anywhere(self, points: Points, rng: np.random.Generator) -> Points:
        """Fold the smaller part over the larger one, over a random line."""
        angle = rng.uniform(0.0, 2.0 * np.pi)
        across = Line.at(angle, 0.0).beyond(points)
        share = 1.0 - rng.uniform(*_FOLDED_PART)
        return self.layers.wrapped(points, Line.at(angle, float(np.quantile(across, share))))

    def half(self, points: Points, rng: np.random.Generator) -> Points:
        """Fold everything in half, so that edges align with edges."""
        angles = axes_of(points)[0] + 0.25 * np.pi * np.arange(8)
        fits = np.array([self._overlap(points, self._middle(points, one)) for one in angles])
        share = np.where(np.arange(8) % 2, _DIAGONAL, 1.0) * np.maximum(fits, 0.05) ** 6
        angle = float(rng.choice(angles, p=share / share.sum()))
        turn_rad, shift_m = self._care(rng)
        line = self._middle(points, angle + turn_rad)
        return self.layers.wrapped(points, Line(line.across, line.offset_m + shift_m))

    def corner(self, points: Points, rng: np.random.Generator) -> Points:
        """Fold one corner inwards."""
        angle = axes_of(points)[0] + 0.5 * np.pi * (rng.integers(4) + 0.5)
        angle += np.radians(12.0) * rng.standard_normal()
        reach = Line.at(angle, 0.0).beyond(points).max()
        depth_m = rng.uniform(*CORNER) * self.size_m
        return self.layers.wrapped(points, Line.at(angle, float(reach - depth_m)))

    def strips(self, points: Points, rng: np.random.Generator) -> Points:
        """Fold in one direction: in thirds, sides to the middle, or in half and half again."""
        first, sides = axes_of(points)
        longer = int(np.argmax(sides))
        axis = longer if rng.random() < 0.7 else 1 - longer
        angle = first + 0.5 * np.pi * axis + np.pi * rng.integers(2)
        turn_rad, shift_m = self._care(rng)
        angle += turn_rad
        way = rng.choice(["thirds", "gate", "quarters", "halves"], p=[0.35, 0.2, 0.2, 0.25])
        if way == "halves":
            folded = self.layers.wrapped(points, self._middle(points, angle, shift_m))
            return self.layers.wrapped(
                folded, self._middle(folded, angle + np.pi * rng.integers(2))
            )
        along = Line.at(angle, 0.0).beyond(points)
        low, high = float(along.min()), float(along.max())
        part = (high - low) / (3.0 if way == "thirds" else 4.0)
        points = self.layers.wrapped(points, Line.at(angle, high - part + shift_m))
        points = self.layers.wrapped(points, Line.at(angle + np.pi, -(low + part) - shift_m))
        if way == "quarters":
            points = self.layers.wrapped(points, self._middle(points, angle))
        return points

    def sleeves(self, points: Points, rng: np.random.Generator) -> Points:
        """Fold the sleeves of a flat shirt over its body, with or without its sides."""
        inside = rng.uniform(0.5, 1.0) * self._body_m
        for side in rng.permutation([0.0, np.pi])[: 1 if rng.random() < 0.15 else 2]:
            angle = side + np.radians(8.0) * rng.standard_normal()
            points = self.layers.wrapped(points, Line.at(angle, inside * rng.uniform(0.95, 1.05)))
        return points

    def roll(self, points: Points, rng: np.random.Generator) -> Points:
        """Roll up cloth from one side, completely or in part."""
        first, sides = axes_of(points)
        longer = int(np.argmax(sides))
        axis = longer if rng.random() < 0.6 else 1 - longer
        angle = first + 0.5 * np.pi * axis + np.pi * rng.integers(2)
        angle += self._care(rng)[0] + np.radians(3.0) * rng.standard_normal()
        along = Line.at(angle, 0.0).beyond(points)
        share = 1.0 if rng.random() < 0.5 else rng.uniform(0.35, 0.9)
        line = Line.at(angle, float(along.max() - share * np.ptp(along)))
        return self.layers.rolled(points, line, rng.uniform(1.0, 1.4))

    def top(self, points: Points, rng: np.random.Generator) -> Points | None:
        """Fold back a part of the uppermost layers only; None when no line has such a part."""
        first, _ = axes_of(points)
        for _ in range(_TRIES):
            angle = first + 0.25 * np.pi * rng.integers(8) + self._care(rng)[0]
            if rng.random() < 0.4:
                angle = rng.uniform(0.0, 2.0 * np.pi)
            reach = Line.at(angle, 0.0).beyond(points).max()
            depth_m = rng.uniform(*_TOP_DEPTH) * self.size_m
            line = Line.at(angle, float(reach - depth_m))
            if (part := self.layers.free_part(points, line, rng)) is not None:
                return self.layers.wrapped(points, line, part)
        return None

    def _care(self, rng: np.random.Generator) -> tuple[float, float]:
        """Draw the errors of a fold's direction [rad] and of its line [m]."""
        careful = rng.random() < EXACT
        turn = (CAREFUL_RAD if careful else CARELESS_RAD) * rng.standard_normal()
        return turn, (CAREFUL if careful else CARELESS) * self.size_m * rng.standard_normal()

    def _middle(self, points: Points, angle: float, shift_m: float = 0.0) -> Line:
        """Return the line that folds one rim onto the other, given the middle layer's bend."""
        along = Line.at(angle, 0.0).beyond(points)
        bend_m = 0.25 * np.pi * (np.ptp(points[:, 2]) + self.layers.thickness_m)
        return Line.at(angle, 0.5 * float(along.max() + along.min() - bend_m) + shift_m)

    def _overlap(self, points: Points, line: Line) -> float:
        """Return the overlap of the folded part and the rest, the smaller of both shares."""
        beyond = line.beyond(points)
        folded = (points - 2.0 * beyond[:, None] * line.across)[beyond > 0.0, :2]
        if not len(folded) or len(folded) == len(points):
            return 0.0
        away, _ = cKDTree(points[beyond <= 0.0, :2]).query(folded)
        back, _ = cKDTree(folded).query(points[beyond <= 0.0, :2])
        return float(min((away < self.layers.edge_m).mean(), (back < self.layers.edge_m).mean()))
