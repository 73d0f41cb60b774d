"""The layers of a cloth that lies folded on a table: pressing, wrapping and rolling.

Cloth beyond a line is wrapped around it, each layer with its own radius, so that layers keep their
order and their lengths. A fold moves a connected part of the mesh beyond the line. The part meets
the rest only at the line, so that nothing is torn, and a part with nothing on top can be folded
back alone.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, cKDTree

from clothtrack.geometry.mesh import ClothMesh

Points = Float[np.ndarray, "vertices 3"]
"""Vertices of a cloth on the table z = 0 [m]."""

_LEAST_PART = 0.015
"""A part with a smaller share of the vertices than this is not folded alone."""

_ONE_PART = 0.6
"""Probability that one of several parts is folded back; otherwise any number of them is."""

_CORE_EDGES = 1.2
"""Smallest radius of a roll's innermost turn over the edge length; a smaller one is a prism."""

_CORE_SAG = 0.125 / _CORE_EDGES
"""Sag of a straight edge inside that turn, over its length; turns need this much extra space."""

_STACKED = 0.65
"""Horizontal distance, over the edge length, below which vertices are stacked; any layer has a
vertex within 0.58."""

_SAME_LAYER = 0.2
"""Vertices whose heights differ by less than this, over the thickness, are of one layer."""

_STIFFNESS = 3
"""Number of passes that smooth the heights of a pressed stack."""

_PRESSES = 40
"""Maximum number of layers of a stack while it is pressed."""

NESTED, NESTED_MOST = 0.15, 0.5
"""Shift of each layer's crease into that of the layer around it, and its maximum, over the edge
length. Without it a crease has no space for another one between the straight edges of a mesh."""

_LOFT_REACH = 2
"""Number of edges from a crease over which its loft fades."""


@dataclass(frozen=True, eq=False)
class Line:
    """A line on the table over which cloth is folded.

    Attributes:
        across: horizontal unit vector from the line towards the folded cloth.
        offset_m: distance of the line from the origin along `across` [m].
    """

    across: Float[np.ndarray, " 3"]
    offset_m: float

    @classmethod
    def at(cls, angle: float, offset_m: float) -> "Line":
        """Return the line whose cloth beyond is in a direction [rad]."""
        return cls(np.array([np.cos(angle), np.sin(angle), 0.0]), offset_m)

    def beyond(self, points: Points) -> Float[np.ndarray, " vertices"]:
        """Return the distance of points beyond the line [m]; negative before it."""
        return points @ self.across - self.offset_m


@dataclass(frozen=True, eq=False)
class Creases:
    """Vertices in creases, and their neighbors on both sides of the crease.

    Attributes:
        creased: whether each vertex lies in a crease.
        vertex: vertex in a crease, one entry for each of its neighbors outside the crease.
        folded: whether the neighbor lies on the side that was folded over.
    """

    creased: Bool[np.ndarray, " vertices"]
    vertex: Int[np.ndarray, " entries"]
    neighbor: Int[np.ndarray, " entries"]
    folded: Bool[np.ndarray, " entries"]

    @classmethod
    def none(cls, vertices: int) -> "Creases":
        """Return the creases of a flat cloth."""
        nothing = np.empty(0, np.int64)
        return cls(np.zeros(vertices, bool), nothing, nothing, np.empty(0, bool))

    def with_crease(
        self,
        mesh: ClothMesh,
        vertices: Int[np.ndarray, " creased"],
        folded: Bool[np.ndarray, " vertices"],
    ) -> "Creases":
        """Return these creases and a new one; a vertex of both belongs to the new one."""
        new = np.zeros(mesh.vertex_count, bool)
        new[vertices] = True
        ends = np.concatenate([mesh.edges, mesh.edges[:, ::-1]])
        ends = ends[new[ends[:, 0]] & ~new[ends[:, 1]]]
        kept = ~new[self.vertex]
        return Creases(
            creased=self.creased | new,
            vertex=np.concatenate([self.vertex[kept], ends[:, 0]]),
            neighbor=np.concatenate([self.neighbor[kept], ends[:, 1]]),
            folded=np.concatenate([self.folded[kept], folded[ends[:, 1]]]),
        )

    def halfway(self, height: Float[np.ndarray, " vertices"]) -> Float[np.ndarray, " vertices"]:
        """Return heights [m] with every crease halfway between its two sides."""
        count = len(height)
        total, sides = np.zeros(count), np.zeros(count)
        for side in (self.folded, ~self.folded):
            number = np.bincount(self.vertex[side], minlength=count)
            total += np.bincount(
                self.vertex[side], height[self.neighbor[side]], count
            ) / np.maximum(number, 1)
            sides += number > 0
        return np.where(sides > 0, total / np.maximum(sides, 1), height)


class Layers:
    """Layers of one garment, with the creases of its folds.

    Attributes:
        edge_m: mean length of its edges [m].
        thickness_m: distance that layers keep [m]; the lowest lies half of it above the table.
        loft_m: additional distance of layers at creases [m].
        creases: creases of all folds since the cloth lay flat.
    """

    def __init__(self, mesh: ClothMesh, thickness_m: float) -> None:
        self.mesh = mesh
        self.edge_m = float(np.mean(mesh.edge_lengths))
        self.thickness_m, self.loft_m = thickness_m, 0.0
        ends, count = np.sort(mesh.edges, axis=1), mesh.vertex_count
        self._joined = ends[:, 0] * count + ends[:, 1]
        both = np.concatenate([ends, ends[:, ::-1]])
        graph = sparse.coo_array((np.ones(len(both)), both.T), shape=(count, count)).tocsr()
        self._mean = sparse.diags_array(1.0 / np.maximum(graph.sum(axis=1), 1.0)) @ graph
        self.creases = Creases.none(count)

    def lay_flat(self) -> None:
        """Forget all creases."""
        self.creases = Creases.none(self.mesh.vertex_count)

    def most(self, points: Points) -> float:
        """Return the number of layers at the 95th percentile of the stack height."""
        heights = self._heights(points, self.thickness_m)
        return float(np.percentile(heights, 95)) / self.thickness_m + 0.5

    def pressed(self, points: Points) -> Points:
        """Lower every layer onto the one below, like a hand that presses a stack.

        Vertices move vertically only, and layers keep their order. Cloth is a little stiff, so a
        step in height extends over the length of an edge or two.
        """
        near = self.creases.creased.astype(np.float64)
        for _ in range(_LOFT_REACH):
            near = np.maximum(near, 2.0 * (self._mean @ near)).clip(max=1.0)
        settled = points.copy()
        settled[:, 2] = self._heights(points, self.thickness_m + self.loft_m * near)
        return settled

    def _heights(
        self, points: Points, gap_m: float | Float[np.ndarray, " vertices"]
    ) -> Float[np.ndarray, " vertices"]:
        """Return heights [m] at which each vertex is a gap [m] above the layer below."""
        lower, upper = self._stacked(points)
        floor = 0.5 * self.thickness_m
        gap = np.broadcast_to(gap_m, len(points))[upper]
        height = np.full(len(points), floor)
        for smoothing in range(_STIFFNESS + 1):
            if smoothing:
                height = np.maximum(0.5 * (height + self._mean @ height), floor)
            for _ in range(_PRESSES):
                before = height.copy()
                np.maximum.at(height, upper, height[lower] + gap)
                if np.array_equal(before, height):
                    break
            height = self.creases.halfway(height)
        return height

    def _stacked(
        self, points: Points
    ) -> tuple[Int[np.ndarray, " pairs"], Int[np.ndarray, " pairs"]]:
        """Return the lower and the upper vertex of each stacked pair."""
        pairs = cKDTree(points[:, :2]).query_pairs(_STACKED * self.edge_m, output_type="ndarray")
        apart = points[pairs[:, 1], 2] - points[pairs[:, 0], 2]
        same = np.isin(pairs.min(axis=1) * len(points) + pairs.max(axis=1), self._joined)
        same |= self.creases.creased[pairs].any(axis=1)
        same |= np.abs(apart) < _SAME_LAYER * self.thickness_m
        pairs, rising = pairs[~same], apart[~same] > 0.0
        pairs = np.where(rising[:, None], pairs, pairs[:, ::-1])
        return pairs[:, 0], pairs[:, 1]

    def wrapped(
        self, points: Points, line: Line, part: Bool[np.ndarray, " vertices"] | None = None
    ) -> Points:
        """Wrap a part beyond a line, or everything there, around the line and onto the rest.

        The end of each crossing edge that is nearer to the line moves into the crease. Otherwise
        the crease would be ragged, because the mesh is not aligned with the line, and layers would
        stick out of one another.
        """
        points = self.pressed(points)
        beyond = line.beyond(points)
        top = float(points[:, 2].max()) + 0.5 * self.thickness_m
        radius = np.maximum(top - points[:, 2], 0.5 * self.thickness_m)
        free = np.ones(len(points), bool) if part is None else part
        creased = self._across(beyond - 0.5 * np.pi * radius, free)
        if not len(creased):
            return points
        way = beyond.copy()
        way[creased] = 0.5 * np.pi * radius[creased]
        moved = free & (way > 0.0)
        moved[creased] = True
        angle = np.where(moved, np.minimum(way / radius, np.pi), 0.0)
        ahead = radius * np.sin(angle) - np.maximum(way - np.pi * radius, 0.0)
        inside = (radius[creased].max() - radius[creased]) / self.thickness_m
        ahead[creased] -= self.edge_m * np.minimum(NESTED * inside, NESTED_MOST)
        wrapped = points.copy()
        wrapped[moved] += ((ahead - beyond)[:, None] * line.across)[moved]
        wrapped[moved, 2] += (radius * (1.0 - np.cos(angle)))[moved]
        self.creases = self.creases.with_crease(self.mesh, creased, angle > 0.5 * np.pi)
        return self.pressed(wrapped)

    def _across(
        self, beyond: Float[np.ndarray, " vertices"], free: Bool[np.ndarray, " vertices"]
    ) -> Int[np.ndarray, " creased"]:
        """Return the nearer ends of the edges of a part that cross the line."""
        ends = self.mesh.edges
        ends = ends[(beyond[ends].prod(axis=1) < 0.0) & free[ends].any(axis=1)]
        nearer = np.abs(beyond[ends]).argmin(axis=1)
        return np.unique(ends[np.arange(len(ends)), nearer])

    def rolled(self, points: Points, line: Line, looseness: float) -> Points:
        """Roll up the cloth beyond a line, towards the line; the rim becomes the roll's core.

        Args:
            points: the vertices [m].
        """
        points = self.pressed(points)
        beyond = np.maximum(line.beyond(points), 0.0)
        floor = float(points[:, 2].min())
        height_m = points[:, 2] - floor
        straight_m = _CORE_SAG * self.edge_m
        pitch_m = looseness * (float(height_m.max()) + self.thickness_m) + straight_m
        core_m = _CORE_EDGES * self.edge_m + float(height_m.max())
        # The wound sheet fills the ring between the core and the outermost turn.
        outer_m = float(np.sqrt(core_m**2 + beyond.max() * pitch_m / np.pi))
        shrink = pitch_m / (2.0 * np.pi)
        angle = (outer_m - np.sqrt(np.maximum(outer_m**2 - 2.0 * shrink * beyond, 0.0))) / shrink
        radius = outer_m - shrink * angle - height_m
        rolled = points + (radius * np.sin(angle) - beyond)[:, None] * line.across
        wound = floor + outer_m - radius * np.cos(angle)
        rolled[:, 2] = np.where(beyond > 0.0, wound, points[:, 2])
        return rolled

    def turned_over(self, points: Points) -> Points:
        """Turn the whole stack over."""
        turned = points * [-1.0, 1.0, -1.0]
        turned[:, 2] += 0.5 * self.thickness_m - turned[:, 2].min()
        return turned

    def free_part(
        self, points: Points, line: Line, rng: np.random.Generator
    ) -> Bool[np.ndarray, " vertices"] | None:
        """Return parts beyond a line with nothing on top; None if there are none, or all are.

        Args:
            points: the vertices [m].
        """
        labels, count = self.parts(line.beyond(points))
        if count < 2:
            return None
        above = self._above(points, labels, count)
        sizes = np.bincount(labels[labels >= 0], minlength=count)
        wanted = 1 if rng.random() < _ONE_PART else int(rng.integers(1, count))
        taken = np.zeros(count, bool)
        for _ in range(wanted):
            free = np.flatnonzero(~taken & ~above[~taken].any(axis=0))
            if not len(free):
                break
            taken[rng.choice(free, p=sizes[free] / sizes[free].sum())] = True
        part = (labels >= 0) & taken[labels]
        return part if not taken.all() and part.mean() > _LEAST_PART else None

    def parts(
        self, beyond: Float[np.ndarray, " vertices"]
    ) -> tuple[Int[np.ndarray, " vertices"], int]:
        """Return the index of each vertex's part beyond a line, and the number of parts.

        The index is -1 for none. A part that hardly reaches beyond the line is not counted.
        """
        inside = beyond > 0.0
        edges = self.mesh.edges[inside[self.mesh.edges].all(axis=1)]
        count = len(beyond)
        graph = sparse.coo_array((np.ones(len(edges)), edges.T), shape=(count, count))
        found, labels = connected_components(graph, directed=False)
        reach = np.zeros(found)
        np.maximum.at(reach, labels, np.where(inside, beyond, 0.0))
        kept = np.flatnonzero(reach > self.edge_m)
        number = np.full(found, -1)
        number[kept] = np.arange(len(kept))
        return np.where(inside, number[labels], -1), len(kept)

    def _above(
        self, points: Points, labels: Int[np.ndarray, " vertices"], count: int
    ) -> Bool[np.ndarray, "parts parts"]:
        """Return whether the first part lies on top of the second anywhere."""
        own = np.flatnonzero(labels >= 0)
        pairs = cKDTree(points[own, :2]).query_pairs(self.edge_m, output_type="ndarray")
        pairs = own[np.concatenate([pairs, pairs[:, ::-1]])]
        upper, lower = labels[pairs].T
        apart = points[pairs[:, 0], 2] - points[pairs[:, 1], 2]
        higher = apart > _SAME_LAYER * self.thickness_m
        above = np.zeros((count, count), bool)
        above[upper[higher], lower[higher]] = True
        np.fill_diagonal(above, val=False)
        return above


def axes_of(points: Points) -> tuple[float, Float[np.ndarray, " 2"]]:
    """Return the orientation and sides of the smallest rectangle around the silhouette.

    Returns:
        The direction of a side [rad]; lengths [m] of the side in that direction and of the other.
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
