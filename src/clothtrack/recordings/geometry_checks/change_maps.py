"""Changes of color and depth from frame to frame, and from pixel to pixel."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from clothtrack.recordings.geometry_checks.small_pictures import SmallPictures

COLOR_NOISE, COLOR_MOST = 12.0, 40.0
"""Change of a channel between frames up to which it is noise, and at which it is clipped [of 255].
A reduced pixel averages the noise of a camera to about 1; the rest is for flicker and shadows."""

HEIGHT_NOISE_M, HEIGHT_MOST_M = 0.004, 0.02
"""The same of the height [m]: with 2 mm of depth noise, reduced pixels differ by 1 mm."""

COLOR_EDGE, HEIGHT_EDGE_M = 3.0, 0.0008
COLOR_EDGE_MOST, HEIGHT_EDGE_MOST_M = 30.0, 0.006
"""The same between neighboring reduced pixels: the slope of a cloth as thick as a coin counts."""


@dataclass(frozen=True, eq=False)
class ChangeMaps:
    """The changes between each frame and the next, 0 where they are noise.

    Attributes:
        color: change of the strongest channel [of 255]; None without color.
        height_m: change of the height [m]; 0 where either was not measured.
    """

    color: Float[np.ndarray, "steps rows columns"] | None
    height_m: Float[np.ndarray, "steps rows columns"]


def change_maps(pictures: SmallPictures, step: int = 1) -> ChangeMaps:
    """Return the changes between frames that are `step` apart."""
    color = pictures.color
    if color is not None:
        shape = color[step:].shape
        apart = cv2.absdiff(color[step:].reshape(-1, 3), color[:-step].reshape(-1, 3))
        # Channel by channel, which is ten times as fast as along the last axis.
        strongest = np.maximum(np.maximum(apart[:, 0], apart[:, 1]), apart[:, 2]).reshape(shape[:3])
        color = np.clip(strongest.astype(np.float32) - COLOR_NOISE, 0.0, COLOR_MOST)
    heights = pictures.height_m
    change = np.nan_to_num(np.abs(heights[step:] - heights[:-step]), nan=0.0)
    return ChangeMaps(color, np.clip(change - HEIGHT_NOISE_M, 0.0, HEIGHT_MOST_M))


def color_edges(color: np.ndarray) -> Float[np.ndarray, "rows columns"]:
    """Return the slope of the strongest channel, less noise, clipped."""
    slope = _slope(color.astype(np.float32))
    # Channel by channel, which is ten times as fast as along the last axis.
    strongest = np.maximum(np.maximum(slope[..., 0], slope[..., 1]), slope[..., 2])
    return np.clip(strongest - COLOR_EDGE, 0.0, COLOR_EDGE_MOST)


def height_edges(height_m: np.ndarray, filled: np.ndarray) -> Float[np.ndarray, "rows columns"]:
    """Return the slope of the height [m], less noise, clipped; `filled` replaces NaN."""
    slope = _slope(np.where(np.isfinite(height_m), height_m, filled).astype(np.float32))
    return np.clip(slope - HEIGHT_EDGE_M, 0.0, HEIGHT_EDGE_MOST_M)


def moving(changes: Float[np.ndarray, "steps rows columns"]) -> Bool[np.ndarray, " steps"]:
    """Return in which steps enough changes for its place to be informative."""
    return (changes > 0).mean(axis=(1, 2)) >= _LEAST_MOVING


_LEAST_MOVING = 0.002
"""Share of the picture that changes when something moves: a tenth of a hand."""


def _slope(picture: np.ndarray) -> np.ndarray:
    soft = cv2.GaussianBlur(picture, (0, 0), 1.0)
    across = cv2.Sobel(soft, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    down = cv2.Sobel(soft, cv2.CV_32F, 0, 1, ksize=3, scale=0.125)
    return cv2.magnitude(across.ravel(), down.ravel()).reshape(picture.shape)
