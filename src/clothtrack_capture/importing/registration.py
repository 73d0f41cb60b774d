"""Registration of depth to the color camera, so that the same pixel shows the same point."""

import threading
from typing import no_type_check

import numpy as np
import warp as wp
from jaxtyping import UInt8, UInt16

from clothtrack.errors import TruncatedError
from clothtrack_capture.importing.intrinsics import Intrinsics, StereoCalibration

# Greater than every painted value; its low 16 bits are 0, which means "no depth".
_FARTHEST = 0x7FFF0000
# Added where a rectangle only reaches a pixel, so that every rectangle that covers it wins.
_BEHIND = wp.constant(0x10000)
_WIDEST = wp.constant(32)
# Less than half a pixel, so that pictures whose pixels coincide gain nothing.
_REACH = wp.constant(0.49)


class Registration:
    """A registration that undistorts both pictures and maps depth to the color camera.

    Each depth pixel is drawn as the rectangle that it covers in the color picture, the nearest
    winning, so that a finer color picture has no cracks. A pixel between rectangles takes the depth
    of one that ends within half a pixel of it, which keeps slanted surfaces closed; edges do not
    grow over what is behind. Pictures that are registered already pass through bit by bit.
    """

    def __init__(self, calibration: StereoCalibration, depth_unit_m: float) -> None:
        self._depth, self._color = calibration.depth, calibration.color or calibration.depth
        self.intrinsics: Intrinsics = self._color.rectified()
        self.carried = not calibration.registered
        self._lock = threading.Lock()
        if self.carried:
            rays = self._depth.corner_rays()
            ahead = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=2)
            # The projections include the intrinsics: pixels times depth, and depth, in units.
            project = self.intrinsics.matrix @ calibration.color_from_depth[:3]
            self._shift = wp.vec3(*(project[:, 3] / depth_unit_m).tolist())
            with np.errstate(over="ignore", invalid="ignore"):
                corners = (ahead @ project[:, :3].T).astype(np.float32)
            self._corners = wp.array(corners, dtype=wp.vec3, device="cpu")
            self._painted = np.empty(self.intrinsics.size[::-1], dtype=np.int32)
            self._pixels = wp.array(self._painted, device="cpu", copy=False)

    def keeps_depth(self, size: tuple[int, int]) -> bool:
        """Return whether depth pictures of this width and height are passed through."""
        return _of_size(size, self._depth).straight and not self.carried

    def keeps_color(self, size: tuple[int, int]) -> bool:
        """Return whether color pictures of this width and height are passed through."""
        return _of_size(size, self._color).straight

    def depth(self, counts: UInt16[np.ndarray, "_ _"]) -> UInt16[np.ndarray, "_ _"]:
        """Return the depth picture for the recording's camera, in the same units."""
        lens = _of_size(counts.shape[1::-1], self._depth)
        if not self.carried:
            return lens.straighten(counts, nearest=True)
        # One launch at a time: the buffers are shared, and Warp handles several threads badly.
        with self._lock:
            self._painted.fill(_FARTHEST)
            measured = wp.array(np.ascontiguousarray(counts), device="cpu", copy=False)
            inputs = [measured, self._corners, self._shift, self._pixels]
            wp.launch(_splat, dim=len(counts), inputs=inputs, device="cpu")
            return self._painted.astype(np.uint16)  # the low 16 bits: 0 where nothing was painted

    def color(
        self, picture: UInt8[np.ndarray, "_ _ *channels"], *, nearest: bool = False
    ) -> UInt8[np.ndarray, "_ _ *channels"]:
        """Return the color picture, or a mask of it (`nearest`), without distortion."""
        return _of_size(picture.shape[1::-1], self._color).straighten(picture, nearest=nearest)


def _of_size(size: tuple[int, ...], lens: Intrinsics) -> Intrinsics:
    if size != lens.size:
        raise TruncatedError(f"a picture of {size[0]} x {size[1]} pixels, but the intrinsics are "
                             f"for {lens.width} x {lens.height}")  # fmt: skip
    return lens


@no_type_check
@wp.kernel(enable_backward=False)
def _splat(
    counts: wp.array2d(dtype=wp.uint16),  # depth [units]
    corners: wp.array2d(dtype=wp.vec3),  # rays of pixel corners, times rotation and intrinsics
    shift: wp.vec3,  # translation to the other camera, times its intrinsics [units]
    painted: wp.array2d(dtype=wp.int32),  # pixels of the other picture, initially _FARTHEST
):
    """Paint every measured pixel of a row as the rectangle between its corners at its depth."""
    row = wp.tid()
    height, width = painted.shape[0], painted.shape[1]
    for column in range(counts.shape[1]):
        count = float(counts[row, column])
        if count == 0.0:
            continue
        one = count * corners[row, column] + shift
        other = count * corners[row + 1, column + 1] + shift
        # This form of the comparison also rejects NaN.
        if not (one[2] > 0.0 and other[2] > 0.0):
            continue
        value = int(0.5 * (one[2] + other[2]) + 0.5)
        near, far = 1.0 / one[2], 1.0 / other[2]
        u, v, s, t = one[0] * near, one[1] * near, other[0] * far, other[1] * far
        left, right, top, bottom = wp.min(u, s), wp.max(u, s), wp.min(v, t), wp.max(v, t)
        inside = right > -1.0 and left < float(width) and bottom > -1.0 and top < float(height)
        if value < 1 or value > 65535 or not inside:
            continue
        # Clip to the picture, because larger coordinates may overflow an integer.
        left, right = wp.max(left, -1.0), wp.min(right, float(width))
        top, bottom = wp.max(top, -1.0), wp.min(bottom, float(height))
        # From here on the rectangle and its extension are in whole pixels.
        first, last = int(wp.ceil(left)), int(wp.ceil(right))
        upper, lower = int(wp.ceil(top)), int(wp.ceil(bottom))
        start = wp.max(int(wp.ceil(left - _REACH)), 0)
        stop = wp.min(wp.min(int(wp.ceil(right + _REACH)), width), start + _WIDEST)
        above = wp.max(int(wp.ceil(top - _REACH)), 0)
        below = wp.min(wp.min(int(wp.ceil(bottom + _REACH)), height), above + _WIDEST)
        for y in range(above, below):
            across = wp.where(y >= upper and y < lower, value, value + _BEHIND)
            for x in range(start, stop):
                depth = wp.where(x >= first and x < last, across, value + _BEHIND)
                wp.atomic_min(painted, y, x, depth)
