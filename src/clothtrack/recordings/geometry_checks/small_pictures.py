"""Reduced pictures of one camera, for cheap checks of motion in color and in depth."""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.errors import ClothTrackError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.camera_view import CameraView
from clothtrack.recordings.pictures import read_color, read_depth, read_mask
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import height_per_depth

COLUMNS = 160
"""Approximate number of columns to which pictures are reduced, by a whole factor."""

MOST_FRAMES = 120
"""Most consecutive frames that are used, from a little before the first action on: more frames show
nothing new, and each frame costs some 10 ms to decode."""


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
        same_color: per frame, whether its color has the same bits as that of the frame before.
    """

    camera: Camera
    factor: int
    frames: tuple[int, ...]
    color: UInt8[np.ndarray, "frames rows columns 3"] | None
    height_m: Float[np.ndarray, "frames rows columns"]
    mask: Float[np.ndarray, "frames rows columns"] | None
    same_color: Bool[np.ndarray, " frames"]
    same_depth: Bool[np.ndarray, " frames"]

    @cached_property
    def filled_m(self) -> Float[np.ndarray, "rows columns"]:
        """Median height of each pixel over all frames [m]; 0 where it was never measured."""
        known = np.isfinite(self.height_m)
        ordered = np.sort(np.where(known, self.height_m, np.inf), axis=0)
        place = np.maximum(known.sum(axis=0) - 1, 0) // 2
        middle = np.take_along_axis(ordered, place[None], axis=0)[0]
        return np.where(np.isfinite(middle), middle, 0.0).astype(np.float32)


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
        self._reduced: dict[int, _Reduced] = {}

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
        reduced = [self._reduced[frame.index] for frame in frames]
        colors = [each.color for each in reduced if each.color is not None]
        return SmallPictures(
            camera,
            _factor(camera),
            tuple(frame.index for frame in frames),
            np.stack(colors) if colors else None,
            np.stack([each.height_m for each in reduced]),
            np.stack(masks) if masks else None,
            _repeated([each.color_sum for each in reduced]),
            _repeated([each.depth_sum for each in reduced]),
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
        self._reduced[frame.index] = _Reduced(
            height_m.astype(np.float32),
            zlib.crc32(depth_m),
            None if color is None else _mean(color, factor),
            None if color is None else zlib.crc32(color),
        )


@dataclass(frozen=True, eq=False)
class _Reduced:
    """The reduced pictures of one frame, and checksums of the whole ones."""

    height_m: Float[np.ndarray, "rows columns"]
    depth_sum: int
    color: UInt8[np.ndarray, "rows columns 3"] | None
    color_sum: int | None


def small_pictures(recording: Recording) -> SmallPictures | None:
    """Return the reduced pictures of the first camera with depth; None if there are none."""
    return PictureReducer(recording).pictures()


def _looked_at(recording: Recording, camera: str) -> Mapping[int, Frame]:
    """Return the frames used, by their number."""
    begin = max(recording.actions[0].first_frame - 10, 0) if recording.actions else 0
    begin = max(min(begin, len(recording.frames) - MOST_FRAMES), 0)
    frames = recording.frames[begin : begin + MOST_FRAMES]
    return {frame.index: frame for frame in frames if camera in frame.depth}


def _repeated(sums: Sequence[int | None]) -> Bool[np.ndarray, " frames"]:
    """Return which checksums equal that of the previous frame; a missing one never does."""
    return np.array([False, *(a is not None and a == b for a, b in pairwise(sums))])


def _factor(camera: Camera) -> int:
    return max(1, round(camera.width / COLUMNS))


def _mean(picture: np.ndarray, factor: int) -> np.ndarray:
    """Return the mean of every block of pixels; a remainder at the rim is left out."""
    rows, columns = (size // factor for size in picture.shape[:2])
    picture = picture[: rows * factor, : columns * factor]
    if picture.dtype == bool:
        picture = picture.astype(np.float32)
    return cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA)
