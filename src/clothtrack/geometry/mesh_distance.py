"""Distance of points from a triangle mesh."""

import numpy as np
import warp as wp
from jaxtyping import Float, Int

from clothtrack.geometry import closest_point_kernels as kernels
from clothtrack.geometry.closest_point import closest_on_triangle, interpolate


def distance_to_mesh(
    points: Float[np.ndarray, "points 3"],
    vertices: Float[np.ndarray, "vertices 3"],
    faces: Int[np.ndarray, "faces 3"],
) -> Float[np.ndarray, " points"]:
    """Return the distance [m] of each point from a mesh.

    A tree finds the nearest face in single precision, about twenty times as fast as
    `closest_on_mesh`; the distance from that face is exact. Due to rounding another face may be
    nearer by about 1e-7 of the size of mesh and cloud.
    """
    middle = vertices.mean(axis=0)
    mesh = wp.Mesh(
        wp.array(np.asarray(vertices - middle, np.float32), dtype=wp.vec3, device="cpu"),
        wp.array(np.asarray(faces, np.int32).ravel(), dtype=wp.int32, device="cpu"),
    )
    nearest = wp.empty(len(points), dtype=wp.int32, device="cpu")
    wp.launch(
        kernels.find_nearest_face,
        dim=len(points),
        inputs=[
            mesh.id,
            wp.array(np.asarray(points - middle, np.float32), dtype=wp.vec3, device="cpu"),
        ],
        outputs=[nearest],
        device="cpu",
    )
    corners = vertices[faces[nearest.numpy()]]
    weights = closest_on_triangle(points, corners)
    return np.linalg.norm(interpolate(weights, corners) - points, axis=1)
