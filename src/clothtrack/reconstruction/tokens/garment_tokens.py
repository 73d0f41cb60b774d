"""The garment input of the token network: points of the garment's own rest mesh.

Every token is a material point. Vertices and pixels are interpolated from the tokens around them,
so one set of tokens gives the correspondence of a pixel and the position of a vertex. Neighbors are
neighbors through the cloth, never across the gap between a sleeve and the body.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy import sparse
from scipy.optimize import nnls
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.closest_point import closest_on_mesh, interpolate
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.tokens.token_symmetries import Layered, labelings, mirrored

TOKENS = 256
"""Tokens per garment: 16 x 16 on a rectangle, 128 on each layer of a sewn garment."""

SHARES = 4
"""Number of tokens that a material point of one layer is interpolated from."""

NEIGHBORS = 8
"""Number of tokens around a token over which the position of a pixel is averaged."""

FEATURES = 7
"""Number of features of a token (`GarmentTokens.features`)."""

_RECTANGLE_FILL = 0.97
_PANEL = 1e-6
_REGULAR = 0.02
_CENTERD = 1e3


@dataclass(frozen=True, eq=False)
class GarmentTokens:
    """Tokens of one garment, in the order that the network sees them.

    Attributes:
        size_m: longer side of the flat garment [m]; the network's unit of length.
        canonical: canonical positions of the tokens [m].
        features: x and y over the size, side (-1, 0, 1), distance to the rim and to a seam over the
            size, and x and y over width and length.
        face, blend: face and barycentric coordinates of each token on the mesh.
        vertex_tokens, vertex_shares: tokens around each vertex, and their interpolation weights.
        labelings: token that each token becomes under each symmetry; the first is the identity.
        is_labeling: which rows are symmetries; the others are padding.
        mirror: token that each token becomes in the mirror image of the garment.
        neighbors: nearest tokens of each through the cloth, itself first.
    """

    size_m: float
    canonical: Float[np.ndarray, "tokens 3"]
    features: Float32[np.ndarray, "tokens features"]
    face: Int[np.ndarray, " tokens"]
    blend: Float[np.ndarray, "tokens 3"]
    vertex_tokens: Int[np.ndarray, "vertices shares"]
    vertex_shares: Float32[np.ndarray, "vertices shares"]
    labelings: Int[np.ndarray, "labelings tokens"]
    is_labeling: Bool[np.ndarray, " labelings"]
    mirror: Int[np.ndarray, " tokens"]
    neighbors: Int[np.ndarray, "tokens neighbors"]
    layers: int

    @classmethod
    def of(cls, mesh: ClothMesh) -> "GarmentTokens":
        """Return the tokens of a flat garment of one layer, or of two that are sewn together.

        Args:
            mesh: at rest, canonical coordinates filled: flat x and y [m], and a height that is
                positive on the front, negative on the back and zero on seams.
        """
        shape = _Shape.of(mesh)
        flat, faces, side = shape.flat, shape.faces, shape.side
        if shape.layers == 1:
            places, sides = _of_one_layer(flat, faces, shape.extent), np.zeros(TOKENS)
        else:
            places, sides = _of_two_layers(flat, side)
        face, blend = _on_layers(places, sides, flat, faces, shape.layered.of_face)
        places = interpolate(blend, flat[faces[face]])
        near, tokens, shares = _shares(shape.layered, places, sides, faces[face])
        return cls(
            **shape.told(places, sides),
            canonical=interpolate(blend, shape.canonical[faces[face]]),
            face=face,
            blend=blend,
            vertex_tokens=tokens,
            vertex_shares=shares.astype(np.float32),
            neighbors=near,
        )

    def stretched(self, mesh: ClothMesh) -> "GarmentTokens":
        """Return the same tokens in the same garment, moderately stretched along x and y.

        Each vertex keeps its weights of the tokens, and each token its neighbors.
        """
        shape = _Shape.of(mesh)
        corners = shape.faces[self.face]
        places = interpolate(self.blend, shape.flat[corners])
        sides = self.features[:, 2].astype(np.float64)
        canonical = interpolate(self.blend, shape.canonical[corners])
        return replace(self, **shape.told(places, sides), canonical=canonical)

    def places(
        self, positions: Float[np.ndarray, "vertices 3"], faces: Int[np.ndarray, "faces 3"]
    ) -> Float[np.ndarray, "tokens 3"]:
        """Return the token positions [m] for these vertex positions."""
        return interpolate(self.blend, positions[faces[self.face]])

    def scaled(self, factor: float) -> "GarmentTokens":
        """Return the tokens of the same garment, larger by a factor (`ClothMesh.scaled`)."""
        return replace(self, size_m=self.size_m * factor, canonical=self.canonical * factor)

    def at_vertices(
        self, values: Float[np.ndarray, "tokens ..."]
    ) -> Float[np.ndarray, "vertices ..."]:
        """Return values of the tokens, interpolated at the vertices."""
        shares = self.vertex_shares.reshape(*self.vertex_shares.shape, *[1] * (values.ndim - 1))
        return (values[self.vertex_tokens] * shares).sum(axis=1)


@dataclass(frozen=True, eq=False)
class _Shape:
    """A flat garment, centered at the origin.

    Attributes:
        canonical: canonical positions of the vertices [m].
        flat: x and y of the vertices [m].
        side: side of each vertex (-1, 0, 1).
        extent: extent along x and y [m].
    """

    canonical: Float[np.ndarray, "vertices 3"]
    flat: Float[np.ndarray, "vertices 2"]
    faces: Int[np.ndarray, "faces 3"]
    side: Float[np.ndarray, " vertices"]
    extent: Float[np.ndarray, " 2"]

    @classmethod
    def of(cls, mesh: ClothMesh) -> "_Shape":
        """Return the shape of a flat mesh."""
        if mesh.canonical is None:
            raise InvalidConfigError(
                "the garment's mesh has no canonical coordinates; make it with clothtrack's "
                "garments, or give a template that has them"
            )
        canonical = np.asarray(mesh.canonical, np.float64)
        level = canonical[:, :2]
        flat = level - 0.5 * (level.min(axis=0) + level.max(axis=0))
        faces = np.asarray(mesh.faces)
        return cls(canonical, flat, faces, _sides(canonical), np.ptp(flat, axis=0))

    @property
    def layers(self) -> int:
        """Number of layers, 1 or 2."""
        return 2 if (self.side != 0).any() else 1

    @property
    def layered(self) -> Layered:
        """Its flat layers."""
        of_face = np.sign(self.side[self.faces].sum(axis=1))
        return Layered(self.flat, self.faces, self.side, of_face)

    def told(
        self, places: Float[np.ndarray, "tokens 2"], sides: Float[np.ndarray, " tokens"]
    ) -> dict[str, Any]:
        """Return the fields that depend only on the tokens' flat positions [m] and sides."""
        size_m = float(self.extent.max())
        layered = self.layered
        names, is_labeling = labelings(layered, places, sides)
        rim, seam = _rim_and_seam(self.faces, self.side, len(self.flat))
        features = np.column_stack(
            [
                places / size_m,
                sides,
                _distance(places, self.flat[rim]) / size_m,
                _distance(places, self.flat[seam]) / size_m,
                places / self.extent,
            ]
        )
        return {
            "size_m": size_m,
            "features": features.astype(np.float32),
            "labelings": names,
            "is_labeling": is_labeling,
            "mirror": mirrored(layered, places, sides),
            "layers": self.layers,
        }


def _sides(canonical: Float[np.ndarray, "vertices 3"]) -> Float[np.ndarray, " vertices"]:
    """Return +1 on the front, -1 on the back, 0 on a seam; all 0 for one layer."""
    height = canonical[:, 2]
    if np.ptp(height) < 1e-9:
        return np.zeros(len(canonical))
    return np.where(np.abs(height) < 1e-6, 0.0, np.sign(height))


def _of_one_layer(
    flat: Float[np.ndarray, "vertices 2"],
    faces: Int[np.ndarray, "faces 3"],
    extent: Float[np.ndarray, " 2"],
) -> Float[np.ndarray, "tokens 2"]:
    """Return a grid over a rectangle, rim included; for other outlines, farthest points."""
    a, b, c = np.moveaxis(flat[faces], 1, 0)
    u, v = b - a, c - a
    area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()
    if area > _RECTANGLE_FILL * extent.prod():
        axis = np.linspace(-0.5, 0.5, round(TOKENS**0.5))
        return np.stack(np.meshgrid(axis, axis), -1).reshape(-1, 2) * extent
    return flat[_far_apart(flat, TOKENS)]


def _of_two_layers(
    flat: Float[np.ndarray, "vertices 2"], side: Float[np.ndarray, " vertices"]
) -> tuple[Float[np.ndarray, "tokens 2"], Float[np.ndarray, " tokens"]]:
    """Return points of the front and their mirror images, and the same points on the back."""
    half = flat[(side >= 0) & (flat[:, 0] >= 0.0)]
    half = half[_far_apart(half, TOKENS // 4)]
    # With an open front, each panel gets its own tokens along the opening.
    half = np.maximum(half, (_PANEL * np.ptp(flat, axis=0).max(), -np.inf))
    front = np.concatenate([half, half * (-1.0, 1.0)])
    sides = np.repeat([1.0, -1.0], TOKENS // 2)
    return np.concatenate([front, front]), sides


def _far_apart(points: Float[np.ndarray, "points 2"], count: int) -> Int[np.ndarray, " chosen"]:
    """Return farthest-point samples; points repeat if there are too few."""
    chosen = np.zeros(count, np.int64)
    chosen[0] = int(np.argmax(np.abs(points).sum(axis=1)))
    apart = np.linalg.norm(points - points[chosen[0]], axis=1)
    for number in range(1, count):
        chosen[number] = int(apart.argmax())
        apart = np.minimum(apart, np.linalg.norm(points - points[chosen[number]], axis=1))
    return chosen


def _on_layers(
    places: Float[np.ndarray, "tokens 2"],
    sides: Float[np.ndarray, " tokens"],
    flat: Float[np.ndarray, "vertices 2"],
    faces: Int[np.ndarray, "faces 3"],
    of_face: Float[np.ndarray, " faces"],
) -> tuple[Int[np.ndarray, " tokens"], Float[np.ndarray, "tokens 3"]]:
    """Return the nearest point on the layer of each token, as face and barycentric weights."""
    level = np.column_stack([flat, np.zeros(len(flat))])
    asked = np.column_stack([places, np.zeros(len(places))])
    face, blend = np.zeros(len(places), np.int64), np.zeros((len(places), 3))
    for value in np.unique(sides):
        own, of_layer = sides == value, np.flatnonzero(of_face == value)
        nearest, weights = closest_on_mesh(asked[own], level, faces[of_layer])
        face[own], blend[own] = of_layer[nearest], weights
    return face, blend


def _shares(
    mesh: Layered,
    places: Float[np.ndarray, "tokens 2"],
    sides: Float[np.ndarray, " tokens"],
    corners: Int[np.ndarray, "tokens 3"],
) -> tuple[
    Int[np.ndarray, "tokens neighbors"],
    Int[np.ndarray, "vertices shares"],
    Float[np.ndarray, "vertices shares"],
]:
    """Return token neighbors, and tokens and weights of vertices; seams use both layers."""
    flat, layers, count = mesh.flat, np.unique(sides), len(mesh.flat)
    near = np.zeros((len(places), NEIGHBORS), np.int64)
    # One layer has as many columns as two, because garments of both kinds share a batch.
    tokens = np.zeros((count, 2 * SHARES), np.int64)
    shares = np.zeros((count, 2 * SHARES))
    for number, value in enumerate(layers):
        own = np.flatnonzero(sides == value)
        apart = _through_cloth(flat, mesh.faces[mesh.of_face == value], places[own], corners[own])
        vertices = np.flatnonzero((mesh.side == value) | (mesh.side == 0.0))
        order = np.argsort(apart[:, vertices], axis=0, kind="stable")[: SHARES + 2].T
        columns = slice(number * SHARES, (number + 1) * SHARES)
        for vertex, candidates in zip(vertices, order, strict=True):
            weights = _convex(places[own[candidates]], flat[vertex])
            best = np.argsort(-weights, kind="stable")[:SHARES]
            tokens[vertex, columns] = own[candidates[best]]
            shares[vertex, columns] = weights[best] / weights[best].sum()
        between = apart[:, count:]
        near[own] = own[np.argsort(between, axis=0, kind="stable")[:NEIGHBORS].T]
    return near, tokens, shares / np.maximum(shares.sum(axis=1, keepdims=True), 1e-12)


def _through_cloth(
    flat: Float[np.ndarray, "vertices 2"],
    faces: Int[np.ndarray, "faces 3"],
    places: Float[np.ndarray, "tokens 2"],
    corners: Int[np.ndarray, "tokens 3"],
) -> Float[np.ndarray, "tokens nodes"]:
    """Return shortest path lengths along edges [m] from tokens to all vertices and tokens."""
    count = len(flat)
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    nodes = count + np.arange(len(places))
    ends = np.concatenate([ends, np.column_stack([np.repeat(nodes, 3), corners.ravel()])])
    at = np.concatenate([flat, places])
    length = np.linalg.norm(at[ends[:, 0]] - at[ends[:, 1]], axis=1) + 1e-9
    # An edge of two faces is listed twice; keep one entry, because a sparse matrix sums them.
    table = {}
    for (a, b), d in zip(ends.tolist(), length.tolist(), strict=True):
        table[min(a, b), max(a, b)] = d
    rows, columns = np.array(list(table)).T
    graph = sparse.csr_array((list(table.values()), (rows, columns)), shape=(len(at), len(at)))
    return dijkstra(graph, directed=False, indices=nodes)


def _convex(
    around: Float[np.ndarray, "candidates 2"], place: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, " candidates"]:
    """Return nonnegative weights that interpolate a position, favoring near candidates."""
    away = around - place
    distance = np.linalg.norm(away, axis=1)
    unit = distance.max() + 1e-12
    rows = np.vstack(
        [away.T / unit, _REGULAR**0.5 * np.diag(distance / unit), _CENTERD * np.ones(len(around))]
    )
    right = np.zeros(len(rows))
    right[-1] = _CENTERD
    weights, _ = nnls(rows, right)
    return weights / weights.sum()


def _rim_and_seam(
    faces: Int[np.ndarray, "faces 3"], side: Float[np.ndarray, " vertices"], count: int
) -> tuple[Bool[np.ndarray, " vertices"], Bool[np.ndarray, " vertices"]]:
    """Return which vertices lie on an open edge, and which on a seam."""
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(ends, axis=0, return_counts=True)
    rim = np.zeros(count, bool)
    rim[edges[counts == 1]] = True
    seam = (side == 0.0) if (side != 0.0).any() else np.zeros(count, bool)
    return rim, seam


def _distance(
    places: Float[np.ndarray, "tokens 2"], others: Float[np.ndarray, "others 2"]
) -> Float[np.ndarray, " tokens"]:
    """Return the distance [m] to the nearest of some points; the extent if there is none."""
    if len(others) == 0:
        return np.full(len(places), float(np.ptp(places, axis=0).max()))
    return cKDTree(others).query(places)[0]
