"""Reduced pictures of one camera, for cheap checks of motion in color and in depth."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from clothtrack.errors import ClothTrackError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import read_color, read_depth, read_mask
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import height_per_depth

_COLUMNS = 160
"""Approximate number of columns to which pictures are reduced, by a whole factor."""

_MOST_FRAMES = 120
"""Most consecutive frames that are used, from a little before the first action on: more frames show
nothing new, and each frame costs some 10 ms to decode."""

_COLOR_EDGE, _HEIGHT_EDGE_M = (3.0, 30.0), (0.0008, 0.006)
"""Change from one reduced pixel to the next up to which it is noise, and at which it is clipped: of
a channel [of 255], and of the height [m]. The slope of a cloth as thick as a coin counts."""

_Height = Float[np.ndarray, "rows columns"]


@dataclass(frozen=True, eq=False)
class SmallPictures:
    """Reduced pictures of the frames of one camera that have depth, in order.

    Attributes:
        factor: pixels of the full picture per reduced pixel, along each axis.
        frames: number of each frame in the recording.
        color: reduced color, red first; None where a frame has none.
        height_m: height above the table [m], or minus the depth where there is no table; NaN where
            less than half of a reduced pixel was measured.
        mask: share of each reduced pixel that is inside the recording's masks; None without masks.
    """

    camera: Camera
    factor: int
    frames: tuple[int, ...]
    color: UInt8[np.ndarray, "frames rows columns 3"] | None
    height_m: Float[np.ndarray, "frames rows columns"]
    mask: Float[np.ndarray, "frames rows columns"] | None

    @cached_property
    def filled_m(self) -> _Height:
        """Median height of each pixel over all frames [m]; 0 where it was never measured."""
        known = np.isfinite(self.height_m)
        ordered = np.sort(np.where(known, self.height_m, np.inf), axis=0)
        place = np.maximum(known.sum(axis=0) - 1, 0) // 2
        middle = np.take_along_axis(ordered, place[None], axis=0)[0]
        return np.where(np.isfinite(middle), middle, 0.0).astype(np.float32)

    @cached_property
    def edges(self) -> list[Float[np.ndarray, "frames rows columns"]]:
        """Slopes of the height and, where there is color, of the strongest channel, less noise."""
        heights = np.where(np.isfinite(self.height_m), self.height_m, self.filled_m)
        maps = [np.stack([_edges(height, *_HEIGHT_EDGE_M) for height in heights])]
        if self.color is not None:
            maps.append(np.stack([_edges(color, *_COLOR_EDGE) for color in self.color]))
        return maps


def small_pictures(recording: Recording) -> SmallPictures | None:
    """Return the reduced pictures of the first camera with depth.

    None if there are none, or one cannot be read.
    """
    camera = next((c for c in recording.cameras if c.name in recording.depth_units_m), None)
    if camera is None:
        return None
    name, factor = camera.name, max(1, round(camera.width / _COLUMNS))
    begin = max(recording.actions[0].first_frame - 10, 0) if recording.actions else 0
    begin = max(min(begin, len(recording.frames) - _MOST_FRAMES), 0)
    frames = [f for f in recording.frames[begin : begin + _MOST_FRAMES] if name in f.depth]
    colors, masks = [], []
    try:
        heights = [_height_m(recording, frame, camera, factor) for frame in frames]
        if all(name in frame.color for frame in frames):
            colors = [_mean(read_color(frame.color[name]), factor) for frame in frames]
        if all(name in frame.mask for frame in frames):
            masks = [_mean(read_mask(frame.mask[name]), factor) for frame in frames]
    except ClothTrackError:
        return None
    if not heights:
        return None
    return SmallPictures(
        camera,
        factor,
        tuple(frame.index for frame in frames),
        np.stack(colors) if colors else None,
        np.stack(heights),
        np.stack(masks) if masks else None,
    )


def _height_m(recording: Recording, frame: Frame, camera: Camera, factor: int) -> _Height:
    depth_m = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
    slope, offset_m = -1.0, 0.0
    if recording.table is not None:
        slope, offset_m = height_per_depth(camera, recording.table)
    share = _mean(depth_m > 0, factor)
    # Pixels without a measurement have depth 0 and add nothing.
    total_m = _mean(depth_m * slope, factor)
    height_m = np.where(share >= 0.5, total_m / np.maximum(share, 0.5) + offset_m, np.nan)
    return height_m.astype(np.float32)


def _mean(picture: np.ndarray, factor: int) -> np.ndarray:
    """Return the mean of every block of pixels; a remainder at the rim is left out."""
    rows, columns = (size // factor for size in picture.shape[:2])
    picture = picture[: rows * factor, : columns * factor]
    if picture.dtype == bool:
        picture = picture.astype(np.float32)
    return cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA)


def _edges(picture: np.ndarray, noise: float, most: float) -> Float[np.ndarray, "rows columns"]:
    """Return the slope of the strongest channel of a picture, less noise, clipped."""
    soft = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 1.0)
    across = cv2.Sobel(soft, cv2.CV_32F, 1, 0, ksize=3, scale=0.125)
    down = cv2.Sobel(soft, cv2.CV_32F, 0, 1, ksize=3, scale=0.125)
    slope = cv2.magnitude(across.ravel(), down.ravel()).reshape(picture.shape)
    if slope.ndim == 3:
        # Channel by channel, which is ten times as fast as along the last axis.
        slope = np.maximum(np.maximum(slope[..., 0], slope[..., 1]), slope[..., 2])
    return np.clip(slope - noise, 0.0, most)
