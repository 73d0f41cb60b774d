"""All frames of one camera, reduced: what moves in color and in depth, looked at cheaply."""

import zlib
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.errors import ClothTrackError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import read_color, read_depth, read_mask
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.segmentation import height_picture

COLUMNS = 160
"""Pictures are reduced by a whole factor to about so many columns."""

MOST_FRAMES = 120
"""So many consecutive frames are looked at, from a little before the first action on: a longer
recording shows nothing else, and each frame costs some 15 ms to decode."""


@dataclass(frozen=True, eq=False)
class SmallPictures:
    """Reduced pictures of the frames of one camera that have depth, in order.

    Attributes:
        camera: the camera, of the full pictures.
        factor: pixels of the full picture per reduced pixel, along each axis.
        frames: number of each frame in the recording.
        color: reduced color, red first; None where a frame has none.
        height_m: height above the table [m], or minus the depth where there is no table; NaN where
            less than half of a reduced pixel was measured.
        mask: share of each reduced pixel that is inside the recording's masks; None without masks.
        same_color: per frame, whether its color has the same bits as that of the frame before.
        same_depth: the same of the depth.
    """

    camera: Camera
    factor: int
    frames: tuple[int, ...]
    color: UInt8[np.ndarray, "frames rows columns 3"] | None
    height_m: Float[np.ndarray, "frames rows columns"]
    mask: Float[np.ndarray, "frames rows columns"] | None
    same_color: Bool[np.ndarray, " frames"]
    same_depth: Bool[np.ndarray, " frames"]


def small_pictures(recording: Recording) -> SmallPictures | None:
    """Return the reduced pictures of the first camera with depth; None where there are none."""
    camera = next((c for c in recording.cameras if c.name in recording.depth_units_m), None)
    if camera is None:
        return None
    begin = max(recording.actions[0].first_frame - 10, 0) if recording.actions else 0
    begin = max(min(begin, len(recording.frames) - MOST_FRAMES), 0)
    shown = [
        frame
        for frame in recording.frames[begin : begin + MOST_FRAMES]
        if camera.name in frame.depth
    ]
    name, factor = camera.name, max(1, round(camera.width / COLUMNS))
    with_color = all(name in frame.color for frame in shown)
    with_mask = all(name in frame.mask for frame in shown)
    colors, heights, masks, sums = [], [], [], []
    try:
        for frame in shown:
            depth = read_depth(frame.depth[name], recording.depth_units_m[name])
            color = read_color(frame.color[name]) if with_color else None
            sums.append((zlib.crc32(depth), None if color is None else zlib.crc32(color)))
            height = -depth
            if recording.table is not None:
                height = height_picture(depth, camera, recording.table)
            heights.append(_reduced_height(height, depth > 0, factor))
            if color is not None:
                colors.append(_reduced(color, factor))
            if with_mask:
                masks.append(_reduced(read_mask(frame.mask[name]).astype(np.float32), factor))
    except ClothTrackError:
        return None
    if not shown:
        return None
    same = [(False, False), *((a[0] == b[0], a[1] == b[1]) for a, b in pairwise(sums))]
    return SmallPictures(
        camera,
        factor,
        tuple(frame.index for frame in shown),
        np.stack(colors) if colors else None,
        np.stack(heights),
        np.stack(masks) if masks else None,
        np.array([color for _, color in same]) & bool(colors),
        np.array([depth for depth, _ in same]),
    )


def _reduced(picture: np.ndarray, factor: int) -> np.ndarray:
    """Mean of every block of pixels; what remains at the rim is left out."""
    rows, columns = (size // factor for size in picture.shape[:2])
    picture = picture[: rows * factor, : columns * factor]
    return cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA)


def _reduced_height(
    height_m: Float[np.ndarray, "height width"],
    measured: Bool[np.ndarray, "height width"],
    factor: int,
) -> Float[np.ndarray, "rows columns"]:
    share = _reduced(measured.astype(np.float32), factor)
    total = _reduced(np.where(measured, height_m, 0.0).astype(np.float32), factor)
    return np.where(share >= 0.5, total / np.maximum(share, 1e-6), np.nan).astype(np.float32)
