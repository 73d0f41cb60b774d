"""Exact closest point of a triangle mesh to a given point."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

_TINY = 1e-30
_PAIRS_AT_ONCE = 2_000_000


def closest_on_mesh(
    points: Float[np.ndarray, "points 3"],
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
) -> tuple[Int[np.ndarray, " points"], Float[np.ndarray, "points 3"]]:
    """Return face and barycentric coordinates of the closest point of a mesh, for each point.

    The result is exact. A face can be closer than the face with the nearest center only if its own
    center lies within that face's distance plus its own radius, and all such faces are tested.

    Args:
        points: query points [m].
        vertices: vertices of the mesh [m].
        faces: vertex indices per triangle.

    Returns:
        The face, and non-negative weights of its three corners that sum to one.
    """
    corners = vertices[faces]
    centers = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centers[:, None], axis=2).max()
    tree = cKDTree(centers)
    near = tree.query(points)[1]
    bound = _gaps(points, corners[near], closest_on_triangle(points, corners[near]))
    candidates = tree.query_ball_point(points, bound + radius + 1e-12)
    counts = np.array([len(faces) for faces in candidates])
    face_of = np.empty(len(points), np.int64)
    weights_of = np.empty((len(points), 3))
    for chunk in _chunks(counts):
        face = np.concatenate([np.asarray(faces, np.int64) for faces in candidates[chunk]])
        owner = np.repeat(np.arange(chunk.stop - chunk.start), counts[chunk])
        queries = points[chunk][owner]
        weights = closest_on_triangle(queries, corners[face])
        gaps = _gaps(queries, corners[face], weights)
        order = np.lexsort((gaps, owner))
        first = order[np.searchsorted(owner[order], np.arange(chunk.stop - chunk.start))]
        face_of[chunk], weights_of[chunk] = face[first], weights[first]
    return face_of, weights_of


def closest_on_triangle(
    points: Float[np.ndarray, "pairs 3"], corners: Float[np.ndarray, "pairs 3 3"]
) -> Float[np.ndarray, "pairs 3"]:
    """Return the barycentric coordinates of each triangle's closest point.

    If the projection lies inside the triangle, it is the closest point; otherwise it is the closest
    point on the three edges.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
    d20, d21 = _dot(ap, ab), _dot(ap, ac)
    determinant = d00 * d11 - d01 * d01
    flat = determinant <= _TINY
    safe = np.where(flat, 1.0, determinant)
    v = (d11 * d20 - d01 * d21) / safe
    w = (d00 * d21 - d01 * d20) / safe
    inside = ~flat & (v >= 0) & (w >= 0) & (v + w <= 1)
    best = np.stack([1 - v - w, v, w], axis=1)
    least = np.where(inside, -1.0, np.inf)
    for start, end in ((0, 1), (1, 2), (2, 0)):
        along = corners[:, end] - corners[:, start]
        length = np.maximum(_dot(along, along), _TINY)
        share = np.clip(_dot(points - corners[:, start], along) / length, 0.0, 1.0)
        gap = points - corners[:, start] - share[:, None] * along
        squared = _dot(gap, gap)
        nearer = squared < least
        weights = np.zeros_like(best)
        weights[:, start], weights[:, end] = 1 - share, share
        best[nearer] = weights[nearer]
        least[nearer] = squared[nearer]
    return best


def interpolate(
    weights: Float[np.ndarray, "points 3"], corners: Float[np.ndarray, "points 3 values"]
) -> Float[np.ndarray, "points values"]:
    """Interpolate values of three corners with barycentric weights: positions, normals."""
    return np.einsum("ij,ijk->ik", weights, corners)


def _gaps(
    points: Float[np.ndarray, "pairs 3"],
    corners: Float[np.ndarray, "pairs 3 3"],
    weights: Float[np.ndarray, "pairs 3"],
) -> Float[np.ndarray, " pairs"]:
    """Return the distance of each point from the weighted mean of its triangle's corners."""
    return np.linalg.norm(interpolate(weights, corners) - points, axis=1)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)


def _chunks(counts: Int[np.ndarray, " points"]) -> list[slice]:
    """Return consecutive slices of points with a bounded number of candidate pairs."""
    total = np.cumsum(counts)
    cuts = [0]
    while cuts[-1] < len(counts):
        done = total[cuts[-1] - 1] if cuts[-1] else 0
        after = int(np.searchsorted(total, done + _PAIRS_AT_ONCE, side="right"))
        cuts.append(max(after, cuts[-1] + 1))
    return [slice(start, stop) for start, stop in pairwise(cuts)]
