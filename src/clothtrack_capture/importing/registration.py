"""Registration of depth to the color camera, so that the same pixel shows the same point."""

import threading

import numpy as np
import warp as wp
from jaxtyping import UInt8, UInt16

from clothtrack.errors import TruncatedError
from clothtrack_capture.importing.intrinsics import Intrinsics
from clothtrack_capture.importing.registration_kernels import FARTHEST, splat
from clothtrack_capture.importing.source import StereoCalibration


class Registration:
    """A registration that undistorts both pictures and maps depth to the color camera.

    Each depth pixel is drawn as the rectangle that it covers in the color picture, so that a finer
    color picture has no cracks. If several fall on one pixel, the nearest is kept. A pixel between
    rectangles takes the depth of one that ends within half a pixel of it. This keeps slanted
    surfaces closed, and edges do not grow over the surface measured behind them. Pixels farther
    from any depth pixel stay 0. Pictures that are already registered are passed through unchanged,
    bit by bit.
    """

    def __init__(self, calibration: StereoCalibration, depth_unit_m: float) -> None:
        """Precompute the rays of every pixel."""
        self._calibration = calibration
        self.intrinsics: Intrinsics = (calibration.color or calibration.depth).rectified()
        self.carried = not calibration.registered
        self._lock = threading.Lock()
        if self.carried:
            rays = calibration.depth.corner_rays()
            ahead = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=2)
            # The projections include the intrinsics: pixels times depth, and depth, in units.
            project = self.intrinsics.matrix @ calibration.color_from_depth[:3]
            shift = project[:, 3] / depth_unit_m
            self._shift = wp.vec3(*shift.tolist())
            with np.errstate(over="ignore", invalid="ignore"):
                corners = (ahead @ project[:, :3].T).astype(np.float32)
            self._corners = wp.array(corners, dtype=wp.vec3, device="cpu")
            self._painted = np.empty(
                (self.intrinsics.height, self.intrinsics.width), dtype=np.int32
            )
            self._pixels = wp.array(self._painted.ravel(), device="cpu", copy=False)

    def keeps_depth(self, size: tuple[int, int]) -> bool:
        """Return whether depth pictures of this width and height are passed through."""
        _check_size(size, self._calibration.depth)
        return not self.carried and self._calibration.depth.straight

    def keeps_color(self, size: tuple[int, int]) -> bool:
        """Return whether color pictures of this width and height are passed through."""
        intrinsics = self._calibration.color or self._calibration.depth
        _check_size(size, intrinsics)
        return intrinsics.straight

    def depth(self, counts: UInt16[np.ndarray, "_ _"]) -> UInt16[np.ndarray, "_ _"]:
        """Return the depth picture for the recording's camera, in the same units."""
        intrinsics = self._calibration.depth
        _check_size(counts.shape[1::-1], intrinsics)
        if not self.carried:
            return intrinsics.straighten(counts, nearest=True)
        # Run one launch at a time, because the buffers are shared and Warp handles several threads
        # badly.
        with self._lock:
            self._painted.fill(FARTHEST)
            wp.launch(
                splat,
                dim=counts.shape[0],
                inputs=[
                    wp.array(np.ascontiguousarray(counts), device="cpu", copy=False),
                    self._corners,
                    self._shift,
                    self.intrinsics.width,
                    self.intrinsics.height,
                    self._pixels,
                ],
                device="cpu",
            )
            # Keep the low 16 bits, which are 0 where nothing was painted.
            return self._painted.astype(np.uint16)

    def color(
        self, picture: UInt8[np.ndarray, "_ _ *channels"], *, nearest: bool = False
    ) -> UInt8[np.ndarray, "_ _ *channels"]:
        """Return the color picture, or a mask of it (`nearest`), without distortion."""
        intrinsics = self._calibration.color or self._calibration.depth
        _check_size(picture.shape[1::-1], intrinsics)
        return intrinsics.straighten(picture, nearest=nearest)


def _check_size(size: tuple[int, ...], intrinsics: Intrinsics) -> None:
    if size != intrinsics.size:
        raise TruncatedError(
            f"a picture of {size[0]} x {size[1]} pixels, but the intrinsics are for "
            f"{intrinsics.width} x {intrinsics.height}"
        )
