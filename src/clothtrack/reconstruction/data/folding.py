"""Folds a garment that lies on a table, as hands do: neatly, layer around layer.

Cloth beyond a line is laid around it, each layer by its own radius, so that layers keep their
order and their lengths. What is folded is a part of the mesh that hangs together beyond the line:
the line is the only place where it meets what stays, so that nothing is torn, and a part that
nothing lies on may be folded back alone.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, cKDTree

from clothtrack.geometry.mesh import ClothMesh

NeatFold = Literal[
    "fold", "fold_half", "fold_corner", "fold_top", "fold_strips", "fold_sleeves", "roll",
    "turn_over",
]  # fmt: skip
NEAT: tuple[str, ...] = get_args(NeatFold)
"""What hands do to a stack of cloth; a garment is mostly folded further after it."""

Points = Float[np.ndarray, "vertices 3"]

EXACT = 0.5
"""Share of folds with which a hand takes care."""

CAREFUL_RAD, CARELESS_RAD = np.radians(0.5), np.radians(4.0)
CAREFUL, CARELESS = 0.004, 0.03
"""Standard deviations of a fold's direction [rad], and of its line over the garment's size."""

DIAGONAL = 0.6
"""How often cloth is folded in half over its diagonal, over how often along a side, where edges
come to lie on edges alike."""

FOLDED_PART = (0.12, 0.5)
"""Least and largest share of the vertices beyond a line that lies anywhere."""

CORNER = (0.08, 0.45)
"""How far from a corner the line lies that folds it, over the garment's size."""

TOP_DEPTH = (0.06, 0.5)
"""How far from its rim upper layers are folded back, over the garment's size."""

LEAST_PART = 0.015
"""A part of fewer vertices than this share is not folded alone."""

TRIES = 12
"""Lines that are tried for a part of the uppermost layers."""

BODY_ROWS = 0.15
"""The lowest share of a shirt's length, by which the width of its body is told."""

STACKED = 0.65
"""Vertices nearer than this lie one above the other, over the length of an edge: any layer has a
vertex within 0.58 of it."""

NESTED = 0.15
STIFFNESS = 3
"""Passes that smooth the heights of a pressed stack."""

MOST_LAYERS = 8

CORE_EDGES = 1.2
"""Least radius of a roll's inmost turn, over the length of an edge: a tighter one is a prism."""


@dataclass(frozen=True, eq=False)
class Line:
    """A line on the table over which cloth is folded.

    Attributes:
        across: horizontal unit vector from the line to the cloth that is folded.
        offset_m: distance of the line from the origin along `across` [m].
    """

    across: Float[np.ndarray, " 3"]
    offset_m: float

    @classmethod
    def at(cls, angle: float, offset_m: float) -> "Line":
        """The line whose cloth beyond lies in a direction [rad]."""
        return cls(np.array([np.cos(angle), np.sin(angle), 0.0]), offset_m)

    def beyond(self, points: Points) -> Float[np.ndarray, " vertices"]:
        """How far points lie beyond the line [m]; below 0 before it."""
        return points @ self.across - self.offset_m


class NeatFolds:
    """Folds of one garment: each takes where the vertices are [m], and returns where they go.

    Attributes:
        mesh: the flat garment; a shirt's neck points to +y.
        thickness_m: distance that layers keep [m]; the lowest lies half of it above the table.
        size_m: longer side of the flat garment [m].
        has_sleeves: something of it sticks out sideways above its lower end.
    """

    def __init__(self, mesh: ClothMesh, thickness_m: float) -> None:
        self.mesh = mesh
        self.thickness_m = thickness_m
        flat = mesh.vertices[:, :2]
        self.size_m = float(np.ptp(flat, axis=0).max())
        self._edge_m = float(np.mean(mesh.edge_lengths))
        ends, count = np.sort(mesh.edges, axis=1), mesh.vertex_count
        self._joined = ends[:, 0] * count + ends[:, 1]
        both = np.concatenate([ends, ends[:, ::-1]])
        graph = sparse.coo_array((np.ones(len(both)), both.T), shape=(count, count)).tocsr()
        self.lay_flat()
        self._mean = sparse.diags_array(1.0 / np.maximum(graph.sum(axis=1), 1.0)) @ graph
        low = flat[:, 1] < flat[:, 1].min() + BODY_ROWS * np.ptp(flat[:, 1])
        self._body_m = float(np.abs(flat[low, 0]).max())
        self.has_sleeves = bool(np.abs(flat[:, 0]).max() > 1.1 * self._body_m)

    def lay_flat(self) -> None:
        """Forget all creases."""
        self.creased = np.zeros(self.mesh.vertex_count, bool)
        nothing = np.empty(0, np.int64)
        self._flanks = nothing, nothing, np.empty(0, bool)

    def fold(
        self, recipe: NeatFold, points: Points, rng: np.random.Generator
    ) -> tuple[NeatFold, Points]:
        """Fold, roll or turn over; what was done, since not everything can be done to any stack."""
        if recipe == "fold_sleeves" and not self.has_sleeves:
            recipe = "fold_strips"
        if recipe == "fold_top":
            if (folded := self.top(points, rng)) is not None:
                return recipe, folded
            recipe = "fold_corner"
        if recipe == "turn_over":
            return recipe, self.turned_over(points)
        way = {
            "fold": self.anywhere, "fold_half": self.half, "fold_corner": self.corner,
            "fold_strips": self.strips, "fold_sleeves": self.sleeves, "roll": self.roll,
        }[recipe]  # fmt: skip
        return recipe, way(points, rng)

    def anywhere(self, points: Points, rng: np.random.Generator) -> Points:
        """Fold the smaller part over the larger one, over any line."""
        angle = rng.uniform(0.0, 2.0 * np.pi)
        across = Line.at(angle, 0.0).beyond(points)
        share = 1.0 - rng.uniform(*FOLDED_PART)
        return self._wrapped(points, Line.at(angle, float(np.quantile(across, share))))

    def half(self, points: Points, rng: np.random.Generator) -> Points:
        """Fold everything in half, so that edges come to lie on edges."""
        angles = _axes(points)[0] + 0.25 * np.pi * np.arange(8)
        fits = np.array([self._overlap(points, self._middle(points, one)) for one in angles])
        share = np.where(np.arange(8) % 2, DIAGONAL, 1.0) * np.maximum(fits, 0.05) ** 6
        angle = float(rng.choice(angles, p=share / share.sum()))
        turn_rad, shift_m = self._care(rng)
        line = self._middle(points, angle + turn_rad)
        return self._wrapped(points, Line(line.across, line.offset_m + shift_m))

    def corner(self, points: Points, rng: np.random.Generator) -> Points:
        """Fold one corner inwards."""
        angle = _axes(points)[0] + 0.5 * np.pi * (rng.integers(4) + 0.5)
        angle += np.radians(12.0) * rng.standard_normal()
        reach = Line.at(angle, 0.0).beyond(points).max()
        depth_m = rng.uniform(*CORNER) * self.size_m
        return self._wrapped(points, Line.at(angle, float(reach - depth_m)))

    def strips(self, points: Points, rng: np.random.Generator) -> Points:
        """Fold in one direction: in thirds, sides to the middle, or in half and half again."""
        first, sides = _axes(points)
        longer = int(np.argmax(sides))
        axis = longer if rng.random() < 0.7 else 1 - longer
        angle = first + 0.5 * np.pi * axis + np.pi * rng.integers(2)
        turn_rad, shift_m = self._care(rng)
        angle += turn_rad
        way = rng.choice(["thirds", "gate", "quarters", "halves"], p=[0.35, 0.2, 0.2, 0.25])
        if way == "halves":
            folded = self._wrapped(points, self._middle(points, angle, shift_m))
            return self._wrapped(folded, self._middle(folded, angle + np.pi * rng.integers(2)))
        along = Line.at(angle, 0.0).beyond(points)
        low, high = float(along.min()), float(along.max())
        part = (high - low) / (3.0 if way == "thirds" else 4.0)
        points = self._wrapped(points, Line.at(angle, high - part + shift_m))
        points = self._wrapped(points, Line.at(angle + np.pi, -(low + part) - shift_m))
        if way == "quarters":
            points = self._wrapped(points, self._middle(points, angle))
        return points

    def sleeves(self, points: Points, rng: np.random.Generator) -> Points:
        """Fold the sleeves of a flat shirt over its body, with or without its sides."""
        inside = rng.uniform(0.5, 1.0) * self._body_m
        for side in rng.permutation([0.0, np.pi])[: 1 if rng.random() < 0.15 else 2]:
            angle = side + np.radians(8.0) * rng.standard_normal()
            points = self._wrapped(points, Line.at(angle, inside * rng.uniform(0.95, 1.05)))
        return points

    def roll(self, points: Points, rng: np.random.Generator) -> Points:
        """Roll cloth up from one side, wholly or in part."""
        first, sides = _axes(points)
        longer = int(np.argmax(sides))
        axis = longer if rng.random() < 0.6 else 1 - longer
        angle = first + 0.5 * np.pi * axis + np.pi * rng.integers(2)
        angle += self._care(rng)[0] + np.radians(3.0) * rng.standard_normal()
        along = Line.at(angle, 0.0).beyond(points)
        share = 1.0 if rng.random() < 0.5 else rng.uniform(0.35, 0.9)
        line = Line.at(angle, float(along.max() - share * np.ptp(along)))
        return self._rolled(points, line, rng.uniform(1.0, 1.4))

    def top(self, points: Points, rng: np.random.Generator) -> Points | None:
        """Fold back a part of the uppermost layers only; None when no line has such a part."""
        first, _ = _axes(points)
        for _ in range(TRIES):
            angle = first + 0.25 * np.pi * rng.integers(8) + self._care(rng)[0]
            if rng.random() < 0.4:
                angle = rng.uniform(0.0, 2.0 * np.pi)
            reach = Line.at(angle, 0.0).beyond(points).max()
            depth_m = rng.uniform(*TOP_DEPTH) * self.size_m
            line = Line.at(angle, float(reach - depth_m))
            if (part := self._free_part(points, line, rng)) is not None:
                return self._wrapped(points, line, part)
        return None

    def turned_over(self, points: Points) -> Points:
        """Turn the whole stack over."""
        turned = points * [-1.0, 1.0, -1.0]
        turned[:, 2] += 0.5 * self.thickness_m - turned[:, 2].min()
        return turned

    def layers(self, points: Points) -> float:
        """Layers where most lie on each other."""
        return float(np.percentile(self.pressed(points)[:, 2], 95)) / self.thickness_m + 0.5

    def _care(self, rng: np.random.Generator) -> tuple[float, float]:
        """How far the direction [rad] and the line [m] are from where a hand aims."""
        careful = rng.random() < EXACT
        turn = (CAREFUL_RAD if careful else CARELESS_RAD) * rng.standard_normal()
        return turn, (CAREFUL if careful else CARELESS) * self.size_m * rng.standard_normal()

    def _middle(self, points: Points, angle: float, shift_m: float = 0.0) -> Line:
        """The line that folds one rim onto the other: the bend of the middle layer counts too."""
        along = Line.at(angle, 0.0).beyond(points)
        bend_m = 0.25 * np.pi * (np.ptp(points[:, 2]) + self.thickness_m)
        return Line.at(angle, 0.5 * float(along.max() + along.min() - bend_m) + shift_m)

    def _overlap(self, points: Points, line: Line) -> float:
        """Share of what is folded over that comes to lie on cloth."""
        beyond = line.beyond(points)
        folded = (points - 2.0 * beyond[:, None] * line.across)[beyond > 0.0, :2]
        if not len(folded) or len(folded) == len(points):
            return 0.0
        away, _ = cKDTree(points[beyond <= 0.0, :2]).query(folded)
        back, _ = cKDTree(folded).query(points[beyond <= 0.0, :2])
        return float(min((away < self._edge_m).mean(), (back < self._edge_m).mean()))

    def _free_part(
        self, points: Points, line: Line, rng: np.random.Generator
    ) -> Bool[np.ndarray, " vertices"] | None:
        """Parts beyond a line that nothing else lies on; None when there are none, or all are."""
        labels, count = self._parts(line.beyond(points))
        if count < 2:
            return None
        above = self._above(points, labels, count)
        sizes = np.bincount(labels[labels >= 0], minlength=count)
        wanted = 1 if rng.random() < 0.6 else int(rng.integers(1, count))
        taken = np.zeros(count, bool)
        for _ in range(wanted):
            free = np.flatnonzero(~taken & ~above[~taken].any(axis=0))
            if not len(free):
                break
            taken[rng.choice(free, p=sizes[free] / sizes[free].sum())] = True
        part = (labels >= 0) & taken[labels]
        return part if not taken.all() and part.mean() > LEAST_PART else None

    def _parts(
        self, beyond: Float[np.ndarray, " vertices"]
    ) -> tuple[Int[np.ndarray, " vertices"], int]:
        """Which part beyond a line each vertex belongs to, and how many parts there are.

        -1: none; nor does a part that hardly reaches beyond it count.
        """
        inside = beyond > 0.0
        edges = self.mesh.edges[inside[self.mesh.edges].all(axis=1)]
        count = len(beyond)
        graph = sparse.coo_array((np.ones(len(edges)), edges.T), shape=(count, count))
        found, labels = connected_components(graph, directed=False)
        reach = np.zeros(found)
        np.maximum.at(reach, labels, np.where(inside, beyond, 0.0))
        kept = np.flatnonzero(reach > self._edge_m)
        number = np.full(found, -1)
        number[kept] = np.arange(len(kept))
        return np.where(inside, number[labels], -1), len(kept)

    def _above(
        self, points: Points, labels: Int[np.ndarray, " vertices"], count: int
    ) -> Bool[np.ndarray, "parts parts"]:
        """Whether the first part lies on the second somewhere."""
        own = np.flatnonzero(labels >= 0)
        pairs = cKDTree(points[own, :2]).query_pairs(self._edge_m, output_type="ndarray")
        pairs = own[np.concatenate([pairs, pairs[:, ::-1]])]
        upper, lower = labels[pairs].T
        higher = points[pairs[:, 0], 2] > points[pairs[:, 1], 2]
        above = np.zeros((count, count), bool)
        above[upper[higher], lower[higher]] = True
        np.fill_diagonal(above, val=False)
        return above

    def _wrapped(
        self, points: Points, line: Line, part: Bool[np.ndarray, " vertices"] | None = None
    ) -> Points:
        """Lay a part beyond a line, or all that is there, around the line and onto the rest.

        Of each edge over the line the nearer end is drawn into the crease: of a mesh that knows
        nothing of the line the crease would be ragged, and layers would stick out of one another.
        """
        points = self.pressed(points)
        beyond, thickness_m = line.beyond(points), self.thickness_m
        top = float(points[:, 2].max()) + 0.5 * thickness_m
        radius = np.maximum(top - points[:, 2], 0.5 * thickness_m)
        from_crease = beyond - 0.5 * np.pi * radius
        ends = self.mesh.edges
        free = np.ones(len(points), bool) if part is None else part
        over = (from_crease[ends].prod(axis=1) < 0.0) & free[ends].any(axis=1)
        ends = ends[over]
        nearer = np.unique(ends[np.arange(len(ends)), np.abs(from_crease[ends]).argmin(axis=1)])
        creased = beyond.copy()
        creased[nearer] = 0.5 * np.pi * radius[nearer]
        moved = free & (creased > 0.0)
        moved[nearer] = True
        angle = np.where(moved, np.minimum(creased / radius, np.pi), 0.0)
        ahead = radius * np.sin(angle) - np.maximum(creased - np.pi * radius, 0.0)
        if len(nearer):
            inside = (radius[nearer].max() - radius[nearer]) / thickness_m
            ahead[nearer] -= np.minimum(NESTED * inside, 0.5) * self._edge_m
        wrapped = points.copy()
        wrapped[moved] += ((ahead - beyond)[:, None] * line.across)[moved]
        wrapped[moved, 2] += (radius * (1.0 - np.cos(angle)))[moved]
        self._crease(nearer, angle)
        return self.pressed(wrapped)

    def _crease(
        self, vertices: Int[np.ndarray, " creased"], angle: Float[np.ndarray, " vertices"]
    ) -> None:
        """Remember the vertices of a crease, and their neighbors on either side of it."""
        self.creased[vertices] = True
        ends = np.concatenate([self.mesh.edges, self.mesh.edges[:, ::-1]])
        new = np.zeros(len(angle), bool)
        new[vertices] = True
        ends = ends[new[ends[:, 0]] & ~new[ends[:, 1]]]
        kept = ~new[self._flanks[0]]
        flanks = ends[:, 0], ends[:, 1], angle[ends[:, 1]] > 0.5 * np.pi
        self._flanks = tuple(
            np.concatenate([old[kept], one]) for old, one in zip(self._flanks, flanks, strict=True)
        )

    def _between(self, height: Float[np.ndarray, " vertices"]) -> Float[np.ndarray, " vertices"]:
        """Heights [m] with creases halfway between what they join."""
        vertex, neighbor, upper = self._flanks
        total, sides = np.zeros(len(height)), np.zeros(len(height))
        for side in (upper, ~upper):
            count = np.bincount(vertex[side], minlength=len(height))
            mean = np.bincount(vertex[side], height[neighbor[side]], len(height))
            total += mean / np.maximum(count, 1)
            sides += count > 0
        return np.where(sides > 0, total / np.maximum(sides, 1), height)

    def pressed(self, points: Points) -> Points:
        """Let every layer down onto what it lies on, as a hand does that presses a stack.

        Nothing moves sideways, and of two layers the same lies above the other. Cloth is a little
        stiff: it leads from step to step over the length of an edge or two.
        """
        thickness_m, floor = self.thickness_m, 0.5 * self.thickness_m
        lower, upper = self._stacked(points)
        height = np.full(len(points), floor)
        for smoothing in range(STIFFNESS + 1):
            if smoothing:
                height = np.maximum(0.5 * (height + self._mean @ height), floor)
            for _ in range(4 * MOST_LAYERS):
                before = height.copy()
                np.maximum.at(height, upper, height[lower] + thickness_m)
                if np.array_equal(before, height):
                    break
            height = self._between(height)
        settled = points.copy()
        settled[:, 2] = height
        return settled

    def _stacked(
        self, points: Points
    ) -> tuple[Int[np.ndarray, " pairs"], Int[np.ndarray, " pairs"]]:
        """Vertices of different layers one above the other: the lower and the upper of each."""
        pairs = cKDTree(points[:, :2]).query_pairs(STACKED * self._edge_m, output_type="ndarray")
        joined = np.isin(pairs.min(axis=1) * len(points) + pairs.max(axis=1), self._joined)
        apart = points[pairs[:, 1], 2] - points[pairs[:, 0], 2]
        joined |= self.creased[pairs].any(axis=1)
        clear = ~joined & (np.abs(apart) > 0.3 * self.thickness_m)
        pairs, rising = pairs[clear], apart[clear] > 0.0
        pairs = np.where(rising[:, None], pairs, pairs[:, ::-1])
        return pairs[:, 0], pairs[:, 1]

    def _rolled(self, points: Points, line: Line, looseness: float) -> Points:
        """Roll up what lies beyond a line, towards the line; the rim becomes the roll's core."""
        points = self.pressed(points)
        beyond = np.maximum(line.beyond(points), 0.0)
        height_m = points[:, 2] - points[:, 2].min()
        pitch_m = looseness * (float(height_m.max()) + self.thickness_m)
        core_m = CORE_EDGES * self._edge_m + float(height_m.max())
        # The area of the wound sheet fills the ring between the core and the outermost turn.
        outer_m = float(np.sqrt(core_m**2 + beyond.max() * pitch_m / np.pi))
        shrink = pitch_m / (2.0 * np.pi)
        angle = (outer_m - np.sqrt(np.maximum(outer_m**2 - 2.0 * shrink * beyond, 0.0))) / shrink
        radius = outer_m - shrink * angle - height_m
        rolled = points + (radius * np.sin(angle) - beyond)[:, None] * line.across
        rolled[:, 2] = np.where(
            beyond > 0.0, points[:, 2].min() + outer_m - radius * np.cos(angle), points[:, 2]
        )
        return rolled


def _axes(points: Points) -> tuple[float, Float[np.ndarray, " 2"]]:
    """Direction of a side of the smallest rectangle around the silhouette [rad], and its sides [m].

    The first side lies in that direction, the second at a right angle.
    """
    flat = points[:, :2]
    hull = flat[ConvexHull(flat).vertices]
    sides = np.roll(hull, -1, axis=0) - hull
    angles = np.arctan2(sides[:, 1], sides[:, 0])
    along = hull @ np.stack([np.cos(angles), np.sin(angles)])
    aside = hull @ np.stack([-np.sin(angles), np.cos(angles)])
    extents = np.stack([np.ptp(along, axis=0), np.ptp(aside, axis=0)])
    best = int(np.argmin(extents.prod(axis=0)))
    return float(angles[best]), extents[:, best]
