"""Closest point of a triangle mesh to a given point."""

import numpy as np
import warp as wp
from jaxtyping import Float, Int

from clothtrack.geometry import closest_point_kernels as kernels

_TINY = 1e-30


def closest_on_mesh(
    points: Float[np.ndarray, "points 3"],
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
) -> tuple[Int[np.ndarray, " points"], Float[np.ndarray, "points 3"]]:
    """Return face and barycentric coordinates of the closest point of a mesh, for each point.

    A tree finds the face in single precision; the point on that face is exact. Due to rounding
    another face may be nearer by about 1e-7 of the size of mesh and points.

    Args:
        points: query points [m].
        vertices: vertices of the mesh [m].
    """
    middle = vertices.mean(axis=0)
    mesh = wp.Mesh(
        wp.array(np.asarray(vertices - middle, np.float32), dtype=wp.vec3, device="cpu"),
        wp.array(np.asarray(faces, np.int32).ravel(), dtype=wp.int32, device="cpu"),
    )
    queries = wp.array(np.asarray(points - middle, np.float32), dtype=wp.vec3, device="cpu")
    nearest = wp.empty(len(points), dtype=wp.int32, device="cpu")
    wp.launch(
        kernels.find_nearest_face,
        dim=len(points),
        inputs=[mesh.id, queries],
        outputs=[nearest],
        device="cpu",
    )
    face = nearest.numpy().astype(np.int64)
    return face, closest_on_triangle(points, vertices[faces[face]])


def distance_to_mesh(
    points: Float[np.ndarray, "points 3"],
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
) -> Float[np.ndarray, " points"]:
    """Return the distance [m] of each point from a mesh (`closest_on_mesh`)."""
    face, weights = closest_on_mesh(points, vertices, faces)
    return np.linalg.norm(interpolate(weights, vertices[faces[face]]) - points, axis=1)


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


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", a, b)
