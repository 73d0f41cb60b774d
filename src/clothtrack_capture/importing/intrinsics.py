"""Pinhole intrinsics of other programs' cameras, with or without distortion."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera

# More pixels mean a damaged header, because the largest supported sensor has 4096 x 3072.
MOST_PIXELS = 4096 * 4096
_BROWN_LENGTHS = (0, 4, 5, 8, 12, 14)
_STRAIGHT_BELOW = 1e-9
_RETURN_LIMIT_PX = 0.5
_WIDEST_RAY = 100.0  # tangent of the angle to the axis: less than a degree from the picture plane


@dataclass(frozen=True)
class Intrinsics:
    """Camera intrinsics with distortion [pixels]; pixel centers are at integers."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    # In OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6, or k1..k4 of a fisheye.
    distortion: tuple[float, ...] = ()
    fisheye: bool = False  # the model is equidistant instead of Brown and Conrady's

    def __post_init__(self) -> None:
        """Refuse impossible intrinsics."""
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not np.isfinite(numbers).all():
            raise InvalidRecordingError(f"intrinsics {numbers} are not finite")
        if not (self.width > 0 and self.height > 0 and self.width * self.height <= MOST_PIXELS):
            size = f"{self.width} x {self.height}"
            raise InvalidRecordingError(f"a camera of {size} pixels; known are 1 to {MOST_PIXELS}")
        known = (4,) if self.fisheye else _BROWN_LENGTHS
        if len(self.distortion) not in known:
            raise InvalidRecordingError(
                f"a {'fisheye ' * self.fisheye}lens with {len(self.distortion)} distortion "
                f"coefficients; known are {', '.join(map(str, known))}"
            )

    @property
    def straight(self) -> bool:
        """Whether there is no distortion."""
        bent = any(abs(value) > _STRAIGHT_BELOW for value in self.distortion)
        return not (self.fisheye or bent)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [pixels]."""
        return self.width, self.height

    def rectified(self) -> "Intrinsics":
        """Return the pinhole with the same focal lengths and center but without distortion."""
        return replace(self, distortion=(), fisheye=False)

    def camera(self, name: str, world_from_camera: Float[np.ndarray, "4 4"]) -> Camera:
        """Return the recording's camera, for pictures without distortion."""
        return Camera(name, *self.size, self.fx, self.fy, self.cx, self.cy, world_from_camera)

    def same_pixels(self, other: "Intrinsics") -> bool:
        """Return whether both map every direction to the same pixel, to a thousandth of a pixel."""
        lenses = [(one.size, () if one.straight else (one.distortion, one.fisheye))
                  for one in (self, other)]  # fmt: skip
        return lenses[0] == lenses[1] and np.allclose(self.matrix, other.matrix, rtol=0, atol=1e-3)

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """The calibration matrix."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def corner_rays(self) -> Float[np.ndarray, "rows columns 2"]:
        """Return the ray (x / z, y / z) of every pixel corner, one row and column more."""
        shape = self.height + 1, self.width + 1
        pixels = np.indices(shape, dtype=np.float64)[::-1].reshape(2, -1).T[:, None] - 0.5
        if self.straight:
            rays = (pixels[:, 0] - (self.cx, self.cy)) / (self.fx, self.fy)
            with np.errstate(over="ignore"):
                return rays.reshape(*shape, 2).astype(np.float32)
        coefficients = np.array(self.distortion)
        if self.fisheye:
            rays = cv2.fisheye.undistortPoints(pixels, self.matrix, coefficients)
            back = cv2.fisheye.distortPoints(rays, self.matrix, coefficients)
        else:
            stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
            # OpenCV 4 has a separate name for the function with a limit on iterations.
            undistort: Any = getattr(cv2, "undistortPointsIter", cv2.undistortPoints)
            eye, still = np.eye(3), np.zeros(3)
            rays = undistort(pixels, self.matrix, coefficients, R=eye, P=eye, criteria=stop)
            ahead = np.insert(rays[:, 0], 2, 1.0, axis=1)
            back, _ = cv2.projectPoints(ahead, still, still, self.matrix, coefficients)
        with np.errstate(invalid="ignore", over="ignore"):
            kept = np.abs(back - pixels).max(axis=(1, 2)) < _RETURN_LIMIT_PX
        rays = rays[:, 0]
        rays[~(kept & (np.abs(rays).max(axis=1) < _WIDEST_RAY))] = np.nan
        return rays.reshape(*shape, 2).astype(np.float32)

    @cached_property
    def _map(self) -> tuple[np.ndarray, np.ndarray]:
        rectify: Any = cv2.fisheye if self.fisheye else cv2
        return rectify.initUndistortRectifyMap(
            self.matrix, np.array(self.distortion), np.eye(3), self.matrix, self.size, cv2.CV_16SC2
        )

    def straighten(
        self, picture: Shaped[np.ndarray, "height width *channels"], *, nearest: bool = False
    ) -> Shaped[np.ndarray, "height width *channels"]:
        """Return the undistorted picture."""
        if self.straight:
            return picture
        how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        return cv2.remap(picture, *self._map, how, borderMode=cv2.BORDER_CONSTANT)
