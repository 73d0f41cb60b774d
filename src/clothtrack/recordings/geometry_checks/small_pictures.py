"""Reduced pictures of one camera, for cheap checks of motion in color and in depth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from clothtrack.errors import ClothTrackError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.camera_view import CameraView
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
_Color = UInt8[np.ndarray, "rows columns 3"]


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


class PictureReducer:
    """A reducer of the pictures of the first camera with depth, once per frame.

    Decoding costs ten times as much as reducing, so code that decodes pictures anyway passes them
    to `look`. The others are read in the end.
    """

    def __init__(self, recording: Recording) -> None:
        """Reduce nothing yet."""
        self._recording = recording
        cameras = [c for c in recording.cameras if c.name in recording.depth_units_m]
        self._camera = cameras[0] if cameras else None
        self._frames = _looked_at(recording, cameras[0].name) if cameras else {}
        self._with_color = all(
            camera.name in frame.color for camera in cameras[:1] for frame in self._frames.values()
        )
        self._reduced: dict[int, tuple[_Height, _Color | None]] = {}

    def look(self, frame: Frame, views: Sequence[CameraView]) -> None:
        """Reduce the decoded pictures of a frame, if it is one of the frames used."""
        if frame.index not in self._frames or frame.index in self._reduced:
            return
        for view in views:
            if self._camera is None or view.camera.name != self._camera.name:
                continue
            if view.color is not None or not self._with_color:
                color = view.color if self._with_color else None
                self._reduce(frame, view.camera, view.depth_m, color)

    def pictures(self) -> SmallPictures | None:
        """Return the reduced pictures; None if there are none, or one cannot be read."""
        camera, frames = self._camera, tuple(self._frames.values())
        if camera is None or not frames:
            return None
        name, masks = camera.name, []
        try:
            for frame in frames:
                if frame.index not in self._reduced:
                    depth_m = read_depth(frame.depth[name], self._recording.depth_units_m[name])
                    color = read_color(frame.color[name]) if self._with_color else None
                    self._reduce(frame, camera, depth_m, color)
            if all(name in frame.mask for frame in frames):
                masks = [_mean(read_mask(frame.mask[name]), _factor(camera)) for frame in frames]
        except ClothTrackError:
            return None
        heights, colors = zip(*(self._reduced[frame.index] for frame in frames), strict=True)
        return SmallPictures(
            camera,
            _factor(camera),
            tuple(frame.index for frame in frames),
            np.stack(colors) if self._with_color else None,
            np.stack(heights),
            np.stack(masks) if masks else None,
        )

    def _reduce(
        self,
        frame: Frame,
        camera: Camera,
        depth_m: Float[np.ndarray, "height width"],
        color: UInt8[np.ndarray, "height width 3"] | None,
    ) -> None:
        factor, table = _factor(camera), self._recording.table
        slope, offset_m = (-1.0, 0.0) if table is None else height_per_depth(camera, table)
        share = _mean(depth_m > 0, factor)
        # Pixels without a measurement have depth 0 and add nothing.
        total_m = _mean(depth_m * slope, factor)
        height_m = np.where(share >= 0.5, total_m / np.maximum(share, 0.5) + offset_m, np.nan)
        small = None if color is None else _mean(color, factor)
        self._reduced[frame.index] = height_m.astype(np.float32), small


def _looked_at(recording: Recording, camera: str) -> Mapping[int, Frame]:
    """Return the frames used, by their number."""
    begin = max(recording.actions[0].first_frame - 10, 0) if recording.actions else 0
    begin = max(min(begin, len(recording.frames) - _MOST_FRAMES), 0)
    frames = recording.frames[begin : begin + _MOST_FRAMES]
    return {frame.index: frame for frame in frames if camera in frame.depth}


def _factor(camera: Camera) -> int:
    return max(1, round(camera.width / _COLUMNS))


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
