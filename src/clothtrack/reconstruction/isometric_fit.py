"""Fits a garment to a picture, preserving edge lengths, low bending and the order of layers.

The vertex positions that a network predicts regress to the mean. Edges between them are a fifth too
short, and a cloth of true lengths that is put there buckles into ripples. The fit therefore
combines edge lengths, bending, the outline, the height of the cloth and the order of its layers.
Each iteration projects onto every term (an edge of its rest length, a bend within the crease
threshold, a vertex in a pixel of the cloth) and solves for the vertices nearest to all projections.
It takes one sparse factorization per round and one substitution per iteration (S. Bouaziz et al.,
Projective dynamics, 2014).
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
"""Weight of the edge lengths in each round, relative to 1 for a well-observed vertex. The first
rounds are weak so that the cloth finds its place before it becomes stiff."""

_GUIDED = 2
"""Number of first rounds that use the network alone; in later rounds its weight decreases."""

_FADING = 0.4
"""Factor on the network's weight in every later round."""

ITERATIONS = 10
"""Iterations per round."""

_BEND = 10.0
"""Weight of bending."""

_CREASE = 0.15
"""Bending above which the cost no longer grows: distance of a vertex from the mean of its
neighbors, over the length of an edge. A sharp fold costs as much as a gentle bow; ripples cost
more."""

_PLACED = 0.1
"""Weight of the predicted position of a vertex that the network is sure of."""

_SURE = 0.02
"""A position with a spread below this, over the garment's longer side, has full weight."""

OFF_NAME, LATER_OFF = 0.05, 0.02
"""A correspondence with this residual, over the longer side, has a quarter of its weight (S. Geman,
D. McClure, 1987), at first and in later rounds."""

NAMED = 600
"""Number of correspondences that are used; more of them are redundant."""

DRAWN = 1.0
"""Weight of the measured surface for the visible vertices."""

REACH = 0.1
"""Measured points farther from the visible vertices than this, over the longer side, are unused."""

CONFINED, POLISHED_CONFINED = 3.0, 10.0
"""Weight of the outline, the height and the order of layers for every vertex, in `IsometricFit.lay`
and in `IsometricFit.polished`."""

GAP_M = 0.002
"""Distance at which layers are kept apart [m], a little less than that of the thinnest layers."""

_PASSES = 3
"""Passes over the pairs of layers in each iteration."""

_VOTES = 4
"""Votes on the layer order that a network predicts; the order of a finished cloth needs one."""

_BEHIND_M = 0.003
"""A vertex at most this far behind the visible surface still counts as visible [m]."""


@dataclass(frozen=True, eq=False)
class Guide:
    """A network's prediction for one garment in one picture.

    Attributes:
        seen: measured points and their canonical positions [m].
        places: predicted vertex positions [m].
        spread_m: mean deviation of each position [m].
        size_m: longer side of the flat garment [m].
    """

    seen: SeenPoints
    places: Float[np.ndarray, "vertices 3"]
    spread_m: Float[np.ndarray, " vertices"]
    size_m: float


class IsometricFit:
    """Fits of one garment to pictures.

    Args:
        rest: the flat garment, canonical coordinates filled [m].
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
        """Return the garment's vertices [m] fitted to the network's prediction and the picture.

        Args:
            order_m: heights that decide which layer is on top [m]; the network's by default.
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
        """Return the vertices [m] attracted to the observed cloth, in their current layer order.

        Args:
            vertices: current positions [m].
            size_m: longer side of the flat garment [m].
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
        """Return the vertices [m] with their heights changed so that layers are apart.

        Args:
            vertices: current positions [m].
            order_m: heights that decide which layer is on top [m].
            table_m: height of the table [m].
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
        """Return which vertices are visible from above."""
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
        """Return weights and targets [m] that attract the visible vertices to measured points.

        Each measured point attracts the nearest visible vertex. A visible vertex that no point
        attracts has the measured point nearest to it as its target.
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
        return weight, target


STILL = 0.02
"""Weight of a vertex's previous position in `IsometricFit.polished`."""

_LEVELLED = 2.0
"""Weight of bending in `IsometricFit.layered`, which separates layers by their heights alone."""

_LAYERINGS = 40
"""Iterations of each loop in `IsometricFit.layered`."""


@dataclass(frozen=True, eq=False)
class _Part:
    """Contribution of the correspondences to the normal equations: per triangle, and right side."""

    corners: Float[np.ndarray, "faces 9"]
    wanted: Float[np.ndarray, "vertices 3"]


@dataclass(frozen=True, eq=False)
class _Names:
    """Correspondences: measured points, their places on the mesh and their confidence."""

    points: Float[np.ndarray, "points 3"]
    face: Int[np.ndarray, " points"]
    blend: Float[np.ndarray, "points 3"]
    faces: Int[np.ndarray, "faces 3"]
    confidence: Float[np.ndarray, " points"]
    count: int

    @classmethod
    def of(cls, guide: Guide, rest: ClothMesh) -> "_Names":
        """Return an evenly spaced subset of the correspondences of a prediction."""
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
        """Return the weight of each correspondence, scaled so that observed vertices average 1."""
        at = np.einsum("pc,pcx->px", self.blend, vertices[self.faces[self.face]])
        miss = _norms(at - self.points)[:, 0] / outlier_m
        weight = self.confidence / (1.0 + miss**2) ** 2
        corners = self.faces[self.face]
        sightings = np.bincount(corners.ravel(), (weight[:, None] * self.blend).ravel(), self.count)
        return weight / np.mean(sightings[sightings > 0.01 * sightings.max()])

    def part(self, weight: Float[np.ndarray, " points"]) -> _Part:
        """Return the contribution to the normal equations with these weights."""
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
    """Return the weights of the vertex targets, and the targets times their weights."""
    if drawn is None:
        return placed, placed[:, None] * places
    weight, target = drawn
    return placed + weight, placed[:, None] * places + weight[:, None] * target


def _norms(rows: Float[np.ndarray, "rows 3"]) -> Float[np.ndarray, "rows 1"]:
    return np.sqrt(np.einsum("ij,ij->i", rows, rows))[:, None]
