"""The views of the cameras in one frame: their pictures, read and segmented once.

Decoding a picture costs as much as everything that is computed from it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import bands, read_color, read_depth
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import (
    ColorSegmenter,
    HeightSegmenter,
    MaskFolder,
    Segmenter,
    cloth_found_by,
    default_segmenter,
    main_components,
)

LEAST_JUMP_M = 0.004
"""Smaller changes of depth from one pixel to the next are noise [m]."""

_COLOR_BLIND = (HeightSegmenter, MaskFolder)
_MAIN_PARTS_ONLY = (ColorSegmenter, HeightSegmenter)


@dataclass(frozen=True, eq=False)
class CameraView:
    """The view of one camera in one frame.

    Attributes:
        color: its color picture, red first; None if there is none or it is not needed.
        depth_m: its depth picture [m]; 0 where nothing was measured.
        mask: pixels of the cloth.
        blind: pixels where nothing was measured, or two surfaces are mixed.
    """

    camera: Camera
    color: UInt8[np.ndarray, "height width 3"] | None
    depth_m: Float32[np.ndarray, "height width"]
    mask: Bool[np.ndarray, "height width"]
    blind: Bool[np.ndarray, "height width"]


def camera_views(
    recording: Recording,
    frame: Frame,
    segmenter: Segmenter | None = None,
    *,
    color: bool = False,
) -> tuple[CameraView, ...]:
    """Return the views of all cameras that have a depth picture of this frame."""
    views = []
    for camera in recording.cameras:
        if camera.name not in frame.depth:
            continue
        depth_m = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
        find = segmenter or default_segmenter(recording, frame, camera)
        looks = camera.name in frame.color and (color or not isinstance(find, _COLOR_BLIND))
        picture = read_color(frame.color[camera.name]) if looks else None
        mask = cloth_found_by(find, recording, frame, camera, color=picture, depth_m=depth_m)
        if not isinstance(find, _MAIN_PARTS_ONLY):
            mask = main_components(mask)
        blind = (depth_m == 0) | flying_pixels(depth_m, camera.fx)
        views.append(CameraView(camera, picture, depth_m, mask, blind))
    return tuple(views)


def flying_pixels(
    depth_m: Float[np.ndarray, "height width"], focal_px: float
) -> Bool[np.ndarray, "height width"]:
    """Return the pixels that mix two surfaces.

    At such a pixel depth rises steeply on both sides, or falls steeply on both sides. Steep is more
    than a surface tilted by 80 degrees shows from one pixel to the next, plus 4 mm of noise. A
    pixel on the rim of a surface has a jump on one side only, and is kept.
    """
    flying = np.zeros(depth_m.size, dtype=bool)
    depth = depth_m.ravel()
    for stride in (depth_m.shape[1], 1):
        middle = _stepping_twice(depth_m, stride)
        back, here, front = depth[middle - stride], depth[middle], depth[middle + stride]
        limit = (6.0 / focal_px) * here + LEAST_JUMP_M
        climbs = (here - back > limit) & (front - here > limit) & (back > 0)
        falls = (here - back < -limit) & (front - here < -limit) & (front > 0)
        flying[middle] |= climbs | falls
    return flying.reshape(depth_m.shape)


def _stepping_twice(
    depth_m: Float[np.ndarray, "height width"], stride: int
) -> Int[np.ndarray, " pixels"]:
    """Return the few pixels (as flat indices) where depth steps up twice, or down twice.

    The stride is the index distance to both neighbors: the width of the picture, or 1.
    """
    height, width = depth_m.shape
    depth = depth_m.ravel()
    found = []
    for rows in bands(height):
        first = max(rows.start * width - stride, 0)
        part = depth[first : rows.stop * width + stride]
        steps = part[stride:] - part[:-stride]
        up, down = steps > LEAST_JUMP_M, steps < -LEAST_JUMP_M
        twice = (up[stride:] & up[:-stride]) | (down[stride:] & down[:-stride])
        found.append(np.flatnonzero(twice) + first + stride)
    middle = np.concatenate(found)
    # The last pixel of a row and the first one of the next are not neighbors.
    column = middle % width
    return middle[(stride == width) | ((column > 0) & (column < width - 1))]
