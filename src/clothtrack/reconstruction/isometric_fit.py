"""Lays a garment into a picture so that it keeps its lengths, bends little and has layers.

A network's places regress to the mean: between them edges are a fifth too short, and a cloth of
true lengths that is put there buckles into ripples. Here lengths, bending, the outline, the height
of the cloth and the order of its layers are asked for together. Each iteration takes what every
term would have (an edge of its length, a bend within what creases may have, a vertex in a pixel of
the cloth), and solves for the vertices that come nearest to all of it: one sparse factorization a
round, one substitution an iteration (S. Bouaziz et al., Projective dynamics, 2014).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.spatial import cKDTree

from clothtrack.geometry.closest_point import closest_on_mesh
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import VisibilityCheck
from clothtrack.reconstruction.layer_order import LayerOrder
from clothtrack.reconstruction.normal_matrix import NormalMatrix
from clothtrack.reconstruction.seen_cloth import SeenCloth
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.reconstruction.smoothness import smoothness_matrix

EDGES = (1.0, 1.0, 1.0, 3.0, 3.0, 10.0, 10.0, 30.0, 30.0)
"""Weight of the edges' lengths in each round, against 1 for a vertex that is well seen: weak first,
so that the cloth finds its place before it is stiff."""

_GUIDED = 2
"""The first so many rounds ask the network alone; in the later ones it counts less and less."""

_FADING = 0.4
"""By what the network's weight is multiplied in every later round."""

ITERATIONS = 10
"""Of each round."""

_BEND = 10.0
"""Weight of bending."""

_CREASE = 0.15
"""Bending that costs no more the sharper it is: distance of a vertex from the mean of its
neighbors, over the length of an edge. A fold is as cheap as a gentle bow, and ripples are not."""

_PLACED = 0.1
"""Weight of the place of a vertex that the network is sure of."""

_SURE = 0.02
"""A spread of a place below this, over the garment's longer side, is as sure as any."""

OFF_NAME, LATER_OFF = 0.05, 0.02
"""A named point that misses its place by this, over the longer side, counts a quarter (S. Geman,
D. McClure, 1987), at first and in later rounds."""

NAMED = 600
"""Named points that are used: more of them say the same."""

DRAWN = 1.0
"""Weight of the measured surface for the visible vertices."""

REACH = 0.1
"""Measured points farther from the visible vertices than this, over the longer side, draw none."""

CONFINED, POLISHED_CONFINED = 3.0, 10.0
"""Weight of the outline, the height and the order of layers for every vertex, while the cloth is
laid and while it is polished."""

GAP_M = 0.002
"""Distance at which layers are kept [m]: a little less than the thinnest have."""

_PASSES = 3
"""Over the pairs of layers in each iteration."""

_VOTES = 4
"""Of the order in which a network says that layers lie; that of a finished cloth needs one."""

_BEHIND_M = 0.003
"""A vertex this much behind the surface that is seen is visible yet [m]."""


@dataclass(frozen=True, eq=False)
class Guide:
    """What a network says of one garment in one picture.

    Attributes:
        seen: measured points and their canonical positions [m].
        places: where the vertices are [m].
        spread_m: mean deviation of each place [m].
        size_m: longer side of the flat garment [m].
    """

    seen: SeenPoints
    places: Float[np.ndarray, "vertices 3"]
    spread_m: Float[np.ndarray, " vertices"]
    size_m: float


class IsometricFit:
    """Fits of one garment, in one size or several.

    Args:
        rest: the flat garment, canonical coordinates filled [m].
        device: of the visibility.
    """

    def __init__(self, rest: ClothMesh, *, device: str = "cpu") -> None:
        self.rest = rest
        self._device = device
        count, edges = rest.vertex_count, rest.edges
        ends = np.repeat(np.arange(len(edges)), 2), edges.ravel()
        signs = np.tile([1.0, -1.0], len(edges))
        self._along = sparse.coo_array((signs, ends), (len(edges), count)).tocsr()
        self._bends = smoothness_matrix(rest)
        self._back_along, self._back_bends = self._along.T, self._bends.T
        self._system = NormalMatrix(self._along, self._bends, rest.faces)
        self._lengths = rest.edge_lengths[:, None]
        self._crease_m = _CREASE * float(self._lengths.mean())
        self.layers = LayerOrder(rest)

    def lay(
        self,
        guide: Guide,
        cloth: SeenCloth,
        edges: tuple[float, ...] = EDGES,
        *,
        layered: bool = True,
        order_m: Float[np.ndarray, " vertices"] | None = None,
    ) -> Float[np.ndarray, "vertices 3"]:
        """The garment's vertices [m] where the network and the picture want them.

        Args:
            guide: what the network says.
            cloth: what was seen.
            edges: weight of the edges' lengths in each round.
            layered: keep layers that lie on each other in their order.
            order_m: heights that say which layer is on top [m]; those of the network by default.
        """
        names = _Names.of(guide, self.rest)
        sure = np.minimum((_SURE * guide.size_m / np.maximum(guide.spread_m, 1e-9)) ** 2, 1.0)
        placed, vertices = _PLACED * sure, guide.places
        order_m = guide.places[:, 2] if order_m is None else order_m
        share = 1.0
        for number, edge in enumerate(edges):
            drawn = None
            off = OFF_NAME
            if number >= _GUIDED:
                share, off = share * _FADING, LATER_OFF
                drawn = self._drawn(vertices, cloth, REACH * guide.size_m)
            if layered and number > 0:
                self.layers.find(vertices, order_m)
            weight = share * names.weights(vertices, off * guide.size_m)
            vertices = self._round(
                vertices, cloth, edge, names.part(weight),
                _pulls(share * placed, guide.places, drawn),
                hold=CONFINED if number else 0.0, layered=layered,
            )  # fmt: skip
        return vertices

    def polished(
        self,
        vertices: Float[np.ndarray, "vertices 3"],
        cloth: SeenCloth,
        size_m: float,
        edges: tuple[float, ...] = (10.0, 30.0),
    ) -> Float[np.ndarray, "vertices 3"]:
        """The vertices [m] drawn to what was seen, by layers that lie as they do.

        Args:
            vertices: where they are [m].
            cloth: what was seen.
            size_m: longer side of the flat garment [m].
            edges: weight of the edges' lengths in each round.
        """
        for edge in edges:
            drawn = self._drawn(vertices, cloth, REACH * size_m)
            self.layers.find(vertices, vertices[:, 2])
            still = np.full(len(vertices), STILL)
            vertices = self._round(
                vertices, cloth, edge, None, _pulls(still, vertices, drawn),
                hold=POLISHED_CONFINED, layered=True,
            )  # fmt: skip
        return vertices

    def layered(
        self, vertices: Float[np.ndarray, "vertices 3"], order_m: Float[np.ndarray, " vertices"],
        table_m: float, *, keep: float = 0.3, votes: int = _VOTES,
    ) -> Float[np.ndarray, "vertices 3"]:  # fmt: skip
        """The vertices [m] at heights at which layers lie apart.

        Args:
            vertices: where they are [m].
            order_m: heights that say which layer is on top [m].
            table_m: height of the table [m].
            keep: weight of the heights as they are.
            votes: of the order (`layer_order.LayerOrder.find`).
        """
        self.layers.find(vertices, order_m, votes=votes)
        given = vertices[:, 2]
        smooth = self._system.factorized(0.0, _LEVELLED, np.full(len(given), keep + 1.0))
        heights = given
        for _ in range(_LAYERINGS):
            wanted = np.maximum(self.layers.apart(heights, GAP_M, 4), table_m)
            heights = smooth.solve(keep * given + wanted)
        for _ in range(_LAYERINGS):
            heights = np.maximum(self.layers.apart(heights, GAP_M, 1), table_m)
        return np.column_stack([vertices[:, :2], heights])

    def visible(self, vertices: Float[np.ndarray, "vertices 3"], cloth: SeenCloth) -> np.ndarray:
        """Which vertices are seen from above."""
        check = VisibilityCheck(
            self.rest.faces, (cloth.camera,), tolerance_m=_BEHIND_M, device=self._device
        )
        return check(vertices)

    def _round(
        self,
        vertices: Float[np.ndarray, "vertices 3"],
        cloth: SeenCloth,
        edge: float,
        named: "_Part | None",
        pulls: tuple[Float[np.ndarray, " vertices"], Float[np.ndarray, "vertices 3"]],
        *,
        hold: float,
        layered: bool,
    ) -> Float[np.ndarray, "vertices 3"]:
        weight, wanted = pulls
        factor = self._system.factorized(
            edge, _BEND, weight + hold, None if named is None else named.corners
        )
        fixed = wanted if named is None else wanted + named.wanted
        along, bends = self._along, self._bends
        for _ in range(ITERATIONS):
            ways = along @ vertices
            ways *= edge * self._lengths / (_norms(ways) + 1e-12)
            bent = bends @ vertices
            bent *= _BEND * np.maximum(1.0 - self._crease_m / (_norms(bent) + 1e-12), 0.0)
            right = fixed + self._back_along @ ways + self._back_bends @ bent
            if hold:
                kept = cloth.confined(vertices)
                if layered:
                    kept[:, 2] = self.layers.apart(kept[:, 2], GAP_M, _PASSES)
                right += hold * kept
            vertices = factor.solve(right)
        return vertices

    def _drawn(
        self, vertices: Float[np.ndarray, "vertices 3"], cloth: SeenCloth, reach_m: float
    ) -> tuple[Float[np.ndarray, " vertices"], Float[np.ndarray, "vertices 3"]]:
        """Weights of what was seen, and where it draws the visible vertices [m].

        Each measured point draws the nearest visible vertex; one that no point draws goes to the
        nearest point itself.
        """
        visible = np.flatnonzero(self.visible(vertices, cloth))
        count = len(vertices)
        if not len(visible):
            return np.zeros(count), vertices
        points = cloth.points
        gap, nearest = cKDTree(vertices[visible]).query(points)
        near = gap < reach_m
        drawing = visible[nearest[near]]
        number = np.bincount(drawing, minlength=count)
        total = np.column_stack(
            [np.bincount(drawing, points[near, axis], count) for axis in range(3)]
        )
        target = total / np.maximum(number, 1)[:, None]
        lone = visible[number[visible] == 0]
        target[lone] = points[cloth.tree.query(vertices[lone])[1]]
        weight = np.zeros(count)
        weight[visible] = DRAWN
        weight[number > 0] = DRAWN
        return weight, target


STILL = 0.02
"""Weight of where a vertex was while a fit is polished."""

_LEVELLED = 2.0
"""Weight of bending while layers are taken apart by their heights alone."""

_LAYERINGS = 40
"""Iterations of that."""


@dataclass(frozen=True, eq=False)
class _Part:
    """The named points' part of the normal equations: per triangle, and the right side."""

    corners: Float[np.ndarray, "faces 9"]
    wanted: Float[np.ndarray, "vertices 3"]


@dataclass(frozen=True, eq=False)
class _Names:
    """Named points: where on the mesh each lies, and how much it counts."""

    points: Float[np.ndarray, "points 3"]
    face: Int[np.ndarray, " points"]
    blend: Float[np.ndarray, "points 3"]
    faces: Int[np.ndarray, "faces 3"]
    confidence: Float[np.ndarray, " points"]
    count: int

    @classmethod
    def of(cls, guide: Guide, rest: ClothMesh) -> "_Names":
        """The named points of an answer, evenly taken."""
        every = max(1, len(guide.seen.points) // NAMED)
        points, canonical = guide.seen.points[::every], guide.seen.canonical[::every]
        flat = np.asarray(rest.canonical, np.float64)
        face, blend = closest_on_mesh(canonical, flat, rest.faces)
        apart = np.einsum("pc,pcx->px", blend, flat[rest.faces[face]]) - canonical
        off = _norms(apart)[:, 0] / (OFF_NAME * guide.size_m)
        confidence = guide.seen.confidence[::every] * np.exp(-(off**2)) + 1e-6
        return cls(points, face, blend, rest.faces, confidence, rest.vertex_count)

    def weights(
        self, vertices: Float[np.ndarray, "vertices 3"], outlier_m: float
    ) -> Float[np.ndarray, " points"]:
        """How much each counts: a mean vertex that is seen has weight 1."""
        at = np.einsum("pc,pcx->px", self.blend, vertices[self.faces[self.face]])
        miss = _norms(at - self.points)[:, 0] / outlier_m
        weight = self.confidence / (1.0 + miss**2) ** 2
        corners = self.faces[self.face]
        sightings = np.bincount(corners.ravel(), (weight[:, None] * self.blend).ravel(), self.count)
        return weight / np.mean(sightings[sightings > 0.01 * sightings.max()])

    def part(self, weight: Float[np.ndarray, " points"]) -> _Part:
        """Their part of the normal equations with these weights."""
        shares = weight[:, None] * self.blend
        squares = (shares[:, :, None] * self.blend[:, None, :]).reshape(-1, 9)
        faces = len(self.faces)
        corners = np.column_stack(
            [np.bincount(self.face, squares[:, entry], faces) for entry in range(9)]
        )
        at = self.faces[self.face].ravel()
        wanted = np.column_stack([
            np.bincount(at, (shares * self.points[:, axis : axis + 1]).ravel(), self.count)
            for axis in range(3)
        ])  # fmt: skip
        return _Part(corners, wanted)


def _pulls(
    placed: Float[np.ndarray, " vertices"],
    places: Float[np.ndarray, "vertices 3"],
    drawn: tuple[Float[np.ndarray, " vertices"], Float[np.ndarray, "vertices 3"]] | None,
) -> tuple[Float[np.ndarray, " vertices"], Float[np.ndarray, "vertices 3"]]:
    """Weights of the vertices' own targets, and these times their weights."""
    if drawn is None:
        return placed, placed[:, None] * places
    weight, target = drawn
    return placed + weight, placed[:, None] * places + weight[:, None] * target


def _norms(rows: Float[np.ndarray, "rows 3"]) -> Float[np.ndarray, "rows 1"]:
    return np.sqrt(np.einsum("ij,ij->i", rows, rows))[:, None]
