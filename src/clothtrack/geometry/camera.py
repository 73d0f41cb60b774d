"""The pinhole camera: pixel centers at integers, x right, y down, z forward (OpenCV, ROS)."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from clothtrack.errors import InvalidRecordingError


@dataclass(frozen=True, eq=False)
class Camera:
    """Pose and projection of a camera.

    Attributes:
        name: the camera's name in the recording.
        width: image width [pixels].
        height: image height [pixels].
        fx: focal length along x [pixels].
        fy: focal length along y [pixels].
        cx: column of the principal point [pixels]; it may be outside an image that was cropped
            from a larger one.
        cy: row of the principal point [pixels], as `cx`.
        world_from_camera: rigid transform, camera frame to world frame.
    """

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_from_camera: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        """Reject values that are not a rigid pinhole camera.

        Raises:
            InvalidRecordingError: with the field, its value and the limit.
        """
        for name in ("width", "height", "fx", "fy"):
            if not getattr(self, name) > 0:
                raise InvalidRecordingError(
                    f"camera {self.name!r}: {name} is {getattr(self, name)}; it must be positive"
                )
        for name, size in (("cx", self.width), ("cy", self.height)):
            # The principal point of a cropped picture may be outside it.
            if not abs(getattr(self, name) - (size - 1) / 2) <= 1.5 * size:
                raise InvalidRecordingError(
                    f"camera {self.name!r}: {name} is {getattr(self, name)}, more than a picture "
                    f"beside the image of {size} pixels ({-size} to {2 * size}); "
                    f"{self._likely_swap()}"
                )
        if problem := rigid_problem(self.world_from_camera):
            raise InvalidRecordingError(f"camera {self.name!r}: world_from_camera {problem}")

    def _likely_swap(self) -> str:
        """Return advice about a principal point far outside the image."""
        if 0 <= self.fx < self.width and 0 <= self.fy < self.height:
            return "were fx, fy and cx, cy swapped? The focal lengths are fx and fy"
        return "give the intrinsics of pictures of this size"

    @property
    def position(self) -> Float[np.ndarray, " 3"]:
        """Center of projection in the world [m]."""
        return self.world_from_camera[:3, 3]

    def camera_from_world_points(
        self, points: Float[np.ndarray, "points 3"]
    ) -> Float[np.ndarray, "points 3"]:
        """Return world points [m] in the camera's frame [m]."""
        return (points - self.position) @ self.world_from_camera[:3, :3]

    def project(
        self, points: Float[np.ndarray, "points 3"]
    ) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
        """Project world points [m] to pixels (column, row) and depth along the optical axis [m]."""
        local = self.camera_from_world_points(points)
        depth = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = local[:, :2] / depth[:, None] * (self.fx, self.fy) + (self.cx, self.cy)
        return pixels, depth

    def back_project(
        self,
        depth: Float[np.ndarray, "height width"],
        mask: Bool[np.ndarray, "height width"] | None = None,
    ) -> Float[np.ndarray, "points 3"]:
        """Return pixels with a measurement (depth > 0) inside the mask as world points [m]."""
        chosen = depth > 0 if mask is None else (depth > 0) & mask
        # Use one index per pixel: an order of magnitude faster than a search for rows and columns.
        places = np.flatnonzero(chosen).astype(np.int32)
        rows = places // depth.shape[1]
        columns = places - rows * depth.shape[1]
        local = np.empty((len(places), 3))
        local[:, 2] = depth.ravel()[places]
        np.multiply((columns - self.cx) / self.fx, local[:, 2], out=local[:, 0])
        np.multiply((rows - self.cy) / self.fy, local[:, 2], out=local[:, 1])
        points = local @ self.world_from_camera[:3, :3].T
        # Process axis by axis, because operations along rows of three are slow.
        for axis, at in enumerate(self.position):
            points[:, axis] += at
        return points

    def scaled(self, factor: float) -> "Camera":
        """Return the camera in a world that is larger by a factor."""
        pose = np.array(self.world_from_camera, dtype=np.float64)
        pose[:3, 3] *= factor
        return replace(self, world_from_camera=pose)

    def turned(self, angle_rad: float) -> "Camera":
        """Return the camera in a world that is rotated about its vertical axis."""
        pose = np.array(self.world_from_camera, dtype=np.float64)
        pose[:3] = about_vertical(angle_rad) @ pose[:3]
        return replace(self, world_from_camera=pose)

    def resized(self, width: int) -> "Camera":
        """Return the same view in an image of another width (whole pixels, aspect kept)."""
        scale = width / self.width
        return Camera(
            self.name,
            width,
            max(1, round(self.height * scale)),
            self.fx * scale,
            self.fy * scale,
            (self.cx + 0.5) * scale - 0.5,
            (self.cy + 0.5) * scale - 0.5,
            self.world_from_camera,
        )


def rigid_problem(matrix: Float[np.ndarray, "4 4"]) -> str:
    """Return why a matrix is not a rigid transform, and what to do; empty if it is one."""
    rotation = matrix[:3, :3]
    error = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if not (error < 1e-3 and np.linalg.det(rotation) > 0):
        return (
            f"is not rigid (its rotation part misses orthonormality by {error:.2g}, limit 1e-3, "
            f"determinant {np.linalg.det(rotation):.3g}, must be +1); write a rotation and meters"
        )
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
        return f"has the last row {matrix[3].tolist()}; it must be 0 0 0 1"
    return ""


def about_vertical(angle_rad: float) -> Float[np.ndarray, "3 3"]:
    """Return the rotation by an angle about z, from x toward y."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
