"""Depth pictures of a cloth with known vertices, and the projection of points to its mesh."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from clothtrack.geometry.camera import Camera, about_vertical
from clothtrack.geometry.closest_point import closest_on_triangle, interpolate


@dataclass(frozen=True, eq=False)
class LabeledPicture:
    """A depth picture of a cloth with known vertex positions.

    Attributes:
        depth_m: measured depth [m]; 0 where nothing was measured.
        faces: face of the mesh that each pixel shows; -1 for none.
        positions: vertices in the world [m], z up.
    """

    depth_m: Float[np.ndarray, "height width"]
    mask: Bool[np.ndarray, "height width"]
    camera: Camera
    faces: Int[np.ndarray, "height width"]
    positions: Float[np.ndarray, "vertices 3"]

    def mirrored(self) -> "LabeledPicture":
        """Return the mirror image, in which the world's x has the opposite sign."""
        pose = self.camera.world_from_camera.copy()
        # Reflect both the world and the picture's columns, so that the pose stays a rotation.
        pose[0, :] *= -1.0
        pose[:3, 0] *= -1.0
        camera = replace(
            self.camera, cx=self.camera.width - 1 - self.camera.cx, world_from_camera=pose
        )
        return LabeledPicture(
            self.depth_m[:, ::-1],
            self.mask[:, ::-1],
            camera,
            self.faces[:, ::-1],
            self.positions * (-1.0, 1.0, 1.0),
        )

    def turned(self, angle: float) -> "LabeledPicture":
        """Return camera and cloth turned about the vertical through the origin [rad]."""
        positions = self.positions @ about_vertical(angle).T
        return replace(self, camera=self.camera.turned(angle), positions=positions)


def faces_of_points(
    points: Float[np.ndarray, "points 3"],
    picture: LabeledPicture,
    faces: Int[np.ndarray, "faces 3"],
    *,
    cut_m: float,
) -> tuple[Int[np.ndarray, " points"], Float[np.ndarray, "points 3"], Bool[np.ndarray, " points"]]:
    """Return the mesh locations of measured points: face, weights of its corners, whether near.

    A point is projected to the face that the picture shows at its pixel. Of the four pixels around
    it, the one with the nearest depth is used.

    Args:
        points: points on the measured surface, in the world [m].
        cut_m: largest distance of a point from the mesh [m].
    """
    pixels, depth = picture.camera.project(points)
    height, width = picture.depth_m.shape
    corner = np.floor(pixels).astype(np.int64)
    steps = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
    columns, rows = np.moveaxis(corner[:, None] + steps, 2, 0)
    columns, rows = columns.clip(0, width - 1), rows.clip(0, height - 1)
    found = np.where(picture.mask, picture.depth_m, 0.0)[rows, columns]
    gaps = np.where(found > 0, np.abs(found - depth[:, None]), np.inf)
    nearest = gaps.argmin(axis=1)
    face = np.take_along_axis(picture.faces[rows, columns], nearest[:, None], axis=1)[:, 0]
    corners = faces[face]
    weights = closest_on_triangle(points, picture.positions[corners])
    on_mesh = interpolate(weights, picture.positions[corners])
    near = np.linalg.norm(on_mesh - points, axis=1) <= cut_m
    return face, weights, near & (face >= 0)
