"""Uniform triangulations of flat outlines: the pattern pieces that garments are sewn from."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay

_CLEARANCE_OF_BOUNDARY = 0.65
"""Minimum distance of interior points from the outline, in spacings, to keep every outline edge."""

SMOOTHING_ROUNDS = 10


@dataclass(frozen=True, eq=False)
class Span:
    """Part of an outline from one corner to the next.

    Attributes:
        points: polyline [m] in the plane; both ends are corners that the mesh keeps.
        sewn: whether the span is a seam to another layer rather than an open edge.
    """

    points: Float[np.ndarray, "points 2"]
    sewn: bool = False

    def resampled(self, spacing: float) -> Float[np.ndarray, "samples 2"]:
        """Return equally spaced points about `spacing` [m] apart, without the last corner."""
        length = _arc_lengths(self.points)[-1]
        return evenly_along(self.points, max(1, round(length / spacing)) + 1)[:-1]


@dataclass(frozen=True, eq=False)
class Piece:
    """Triangulated outline; the outline's vertices come first, counterclockwise.

    Attributes:
        points: vertices [m] in the plane.
    """

    points: Float[np.ndarray, "vertices 2"]
    faces: Int[np.ndarray, "faces 3"]
    sewn: Bool[np.ndarray, " vertices"]


def evenly_along(
    points: Float[np.ndarray, "points 2"], count: int
) -> Float[np.ndarray, "samples 2"]:
    """Return `count` equally spaced points of an open polyline, both ends included."""
    along = _arc_lengths(points)
    at = np.linspace(0.0, along[-1], count)
    return np.stack([np.interp(at, along, axis) for axis in points.T], axis=1)


def _arc_lengths(points: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, " points"]:
    """Return the length [m] of a polyline up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def distance_to_polyline(
    points: Float[np.ndarray, "points 2"], polyline: Float[np.ndarray, "corners 2"]
) -> Float[np.ndarray, " points"]:
    """Return the distance [m] of each point to an open polyline in the plane."""
    start, along = polyline[:-1], np.diff(polyline, axis=0)
    nearest = np.full(len(points), np.inf)
    for origin, direction in zip(start, along, strict=True):
        offset = points - origin
        share = np.clip(offset @ direction / (direction @ direction), 0.0, 1.0)
        np.minimum(
            nearest, np.linalg.norm(offset - share[:, None] * direction, axis=1), out=nearest
        )
    return nearest


def inside(
    points: Float[np.ndarray, "points 2"], polygon: Float[np.ndarray, "corners 2"]
) -> Bool[np.ndarray, " points"]:
    """Return whether each point lies in a simple polygon (even-odd rule)."""
    odd = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 == y1:
            continue
        spans = (points[:, 1] < y0) != (points[:, 1] < y1)
        odd ^= spans & (points[:, 0] < x0 + (points[:, 1] - y0) * (x1 - x0) / (y1 - y0))
    return odd


def triangulate(spans: list[Span], spacing: float, seed: int) -> Piece:
    """Triangulate an outline almost equilaterally, with vertices on the outline itself.

    A triangular lattice with random rotation and shift fills the inside. Delaunay triangulation
    and Laplacian smoothing alternate until the lattice meets the outline evenly. No edge inside the
    piece joins two sewn vertices, because sewing two layers would make that edge non-manifold.

    Args:
        spacing: length of an edge [m].
    """
    samples = [span.resampled(spacing) for span in spans]
    outline = np.concatenate(samples)
    # A corner belongs to the seam if either of its two spans is sewn.
    sewn = np.concatenate(
        [np.full(len(points), span.sewn) for span, points in zip(spans, samples, strict=True)]
    )
    starts = np.cumsum([0] + [len(points) for points in samples[:-1]])
    for start, before in zip(starts, [spans[-1], *spans[:-1]], strict=True):
        sewn[start] |= before.sewn

    interior = _lattice(outline, spacing, np.random.default_rng(seed))
    for _ in range(SMOOTHING_ROUNDS):
        points = np.concatenate([outline, interior])
        faces = _delaunay(points, outline, spacing)
        interior = _neighbor_mean(points, faces)[len(outline) :]
    points = np.concatenate([outline, interior])
    faces = _delaunay(points, outline, spacing)
    sewn = np.concatenate([sewn, np.zeros(len(interior), dtype=bool)])
    return _without_chords(Piece(points, faces, sewn))


def _lattice(
    outline: Float[np.ndarray, "corners 2"], spacing: float, rng: np.random.Generator
) -> Float[np.ndarray, "points 2"]:
    center = (outline.min(axis=0) + outline.max(axis=0)) / 2.0
    reach = np.linalg.norm(np.ptp(outline, axis=0)) / 2.0 + 2.0 * spacing
    count = int(np.ceil(reach / spacing * 2.0 / np.sqrt(3.0))) + 1
    i, j = np.meshgrid(np.arange(-count, count + 1), np.arange(-count, count + 1))
    lattice = np.stack([i + 0.5 * (j % 2), j * np.sqrt(3.0) / 2.0], axis=-1).reshape(-1, 2)
    angle = rng.uniform(0.0, np.pi / 3.0)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    lattice = (lattice + rng.uniform(0.0, 1.0, 2)) @ turn * spacing + center
    lattice = lattice[inside(lattice, outline)]
    closed = np.concatenate([outline, outline[:1]])
    return lattice[distance_to_polyline(lattice, closed) > _CLEARANCE_OF_BOUNDARY * spacing]


def _delaunay(
    points: Float[np.ndarray, "points 2"], outline: Float[np.ndarray, "corners 2"], spacing: float
) -> Int[np.ndarray, "faces 3"]:
    faces = Delaunay(points).simplices.astype(np.int32)
    area = _signed_areas(points, faces)
    faces[area < 0] = faces[area < 0][:, ::-1]
    # Collinear points on a straight edge cause triangles of zero area outside it.
    kept = (np.abs(area) > 1e-3 * spacing**2) & inside(points[faces].mean(axis=1), outline)
    return faces[kept]


def _signed_areas(
    points: Float[np.ndarray, "points 2"], faces: Int[np.ndarray, "faces 3"]
) -> Float[np.ndarray, " faces"]:
    a, b, c = np.moveaxis(points[faces], 1, 0)
    u, v = b - a, c - a
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def _neighbor_mean(
    points: Float[np.ndarray, "points 2"], faces: Int[np.ndarray, "faces 3"]
) -> Float[np.ndarray, "points 2"]:
    # Inside a piece each edge counts twice, once per triangle, so the mean is unweighted.
    ends = np.concatenate([faces, faces[:, ::-1]])[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    total = np.zeros_like(points)
    np.add.at(total, ends[:, 0], points[ends[:, 1]])
    return total / np.maximum(np.bincount(ends[:, 0], minlength=len(points)), 1)[:, None]


def _without_chords(piece: Piece) -> Piece:
    """Split every inner edge between two sewn vertices at its middle."""
    points, faces, sewn = piece.points, piece.faces, piece.sewn
    while True:
        sides = faces[:, [[0, 1], [1, 2], [2, 0]]]
        edges, counts = np.unique(np.sort(sides.reshape(-1, 2), axis=1), axis=0, return_counts=True)
        chords = edges[(counts == 2) & sewn[edges].all(axis=1)]
        if len(chords) == 0:
            return Piece(points, faces, sewn)
        a, b = chords[0]
        split = (faces == a).any(axis=1) & (faces == b).any(axis=1)
        middle = len(points)
        halves = [np.where(faces[split] == corner, middle, faces[split]) for corner in (a, b)]
        faces = np.concatenate([faces[~split], *halves]).astype(np.int32)
        points = np.concatenate([points, points[[a, b]].mean(axis=0, keepdims=True)])
        sewn = np.append(sewn, False)
