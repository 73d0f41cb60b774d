"""A depth picture of a cloud, as measured by a camera straight above.

The network's input is a picture. A recording of points alone, of one camera or merged from several,
is rendered to a picture here. Points under other points are not visible in it.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.segmentation import main_components

_ABOVE_M = 1.5
"""Height of the virtual camera above the highest point [m]."""

FINEST_M, COARSEST_M = 0.002, 0.01
"""Bounds of a pixel's width at the middle of the cloud [m]."""

_SPACINGS = 2.0
"""Pixel width over the 90th percentile of the horizontal nearest-neighbor distance, chosen so that
few pixels are empty."""

LEAST_POINTS = 16
"""Minimum number of points of a cloud that shows cloth."""

_EDGE = 2
_ENCLOSED = 5
"""Number of measured pixels among eight neighbors from which an empty pixel is a hole."""


def cloud_picture(
    points: Float[np.ndarray, "points 3"],
) -> tuple[Float[np.ndarray, "height width"], Bool[np.ndarray, "height width"], Camera]:
    """Return depth [m], mask of measured pixels, and the camera straight above the points.

    Each pixel shows its highest point. Holes of one pixel are filled with the median of their
    neighbors. Larger holes stay, because their depth is unknown. Separate parts smaller than a
    quarter of the largest are dropped, as in masks (`main_components`).

    Args:
        points: points of the cloth [m], world, z up.
    """
    if len(points) < LEAST_POINTS:
        raise InvalidRecordingError(
            f"a cloud of {len(points)} points shows no cloth (at least {LEAST_POINTS}); is this "
            "the right frame?"
        )
    camera = _camera_above(points)
    pixels, depth = camera.project(points)
    columns, rows = np.rint(pixels).astype(int).T
    picture = np.full((camera.height, camera.width), np.inf)
    np.minimum.at(picture, (rows, columns), depth)
    picture = _without_holes(np.where(np.isfinite(picture), picture, 0.0))
    mask = main_components(picture > 0)
    return np.where(mask, picture, 0.0), mask, camera


def _camera_above(points: Float[np.ndarray, "points 3"]) -> Camera:
    spacing_m = cKDTree(points[:, :2]).query(points[:, :2], k=2)[0][:, 1]
    pixel_m = float(np.clip(_SPACINGS * np.percentile(spacing_m, 90), FINEST_M, COARSEST_M))
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = middle[0], middle[1], high[2] + _ABOVE_M
    focal = (pose[2, 3] - float(np.median(points[:, 2]))) / pixel_m
    # The highest points, `_ABOVE_M` below the camera, appear largest.
    half = np.ceil(0.5 * (high - low)[:2] * focal / _ABOVE_M).astype(int) + _EDGE
    width, height = (2 * half + 1).tolist()
    return Camera("above", width, height, focal, focal, float(half[0]), float(half[1]), pose)


def _without_holes(depth: Float[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
    padded = np.pad(np.where(depth > 0, depth, np.nan), 1, constant_values=np.nan)
    around = [
        padded[1 + y : padded.shape[0] - 1 + y, 1 + x : padded.shape[1] - 1 + x]
        for y in (-1, 0, 1)
        for x in (-1, 0, 1)
        if (x, y) != (0, 0)
    ]
    neighbors = np.stack(around, axis=-1)
    hole = (depth == 0) & (np.isfinite(neighbors).sum(axis=-1) >= _ENCLOSED)
    closed = depth.copy()
    closed[hole] = np.nanmedian(neighbors[hole], axis=-1)
    return closed
