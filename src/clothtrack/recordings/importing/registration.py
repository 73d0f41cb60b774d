"""Depth as the colour camera would have measured it: the same pixel shows the same point."""

import threading

import numpy as np
import warp as wp
from jaxtyping import UInt8, UInt16

from clothtrack.recordings.importing.containers import TornError
from clothtrack.recordings.importing.lens import Lens
from clothtrack.recordings.importing.registration_kernels import FARTHEST, splat
from clothtrack.recordings.importing.source import Rig


class Registration:
    """Takes distortion out of both pictures and carries depth to the colour camera.

    Each depth pixel is painted as the rectangle that it covers there, so that a finer colour
    picture has no cracks; where several fall on one pixel, the nearest stays. A pixel between the
    rectangles takes one that ends within half a pixel of it: slanted surfaces stay whole, and no
    edge grows over what was measured behind it. What is farther from any depth pixel stays 0.
    Pictures that are registered already pass through, bit by bit.
    """

    def __init__(self, rig: Rig) -> None:
        """Prepare the rays of every pixel once."""
        self._rig = rig
        self.lens: Lens = (rig.color or rig.depth).rectified()
        self.carried = not rig.registered
        self._lock = threading.Lock()
        if self.carried:
            rays = rig.depth.corner_rays()
            self._corners = wp.array(rays, dtype=wp.vec2, device="cpu")
            self._painted = np.empty((2, self.lens.width * self.lens.height), dtype=np.int32)
            self._pixels = [wp.array(one, device="cpu", copy=False) for one in self._painted]
            pose = rig.color_from_depth
            self._rotation = wp.mat33(*pose[:3, :3].ravel().tolist())
            self._translation = wp.vec3(*pose[:3, 3].tolist())

    def depth(self, counts: UInt16[np.ndarray, "_ _"]) -> UInt16[np.ndarray, "_ _"]:
        """The depth picture of the recording's camera, in the same units.

        Raises:
            TornError: the picture has another size than its lens.
        """
        lens = self._rig.depth
        _check_size(counts, lens)
        if not self.carried:
            return lens.straighten(counts, nearest=True)
        # One launch at a time: the buffers are shared, and Warp does not like several threads.
        with self._lock:
            self._painted.fill(FARTHEST)
            wp.launch(
                splat,
                dim=counts.shape,
                inputs=[
                    wp.array(np.ascontiguousarray(counts), device="cpu", copy=False),
                    self._corners,
                    self._rotation,
                    self._translation,
                    self._rig.depth_unit_m,
                    wp.vec2(self.lens.fx, self.lens.fy),
                    wp.vec2(self.lens.cx, self.lens.cy),
                    self.lens.width,
                    self.lens.height,
                    *self._pixels,
                ],
                device="cpu",
            )
            nearest, around = self._painted
            np.copyto(nearest, around, where=nearest == FARTHEST)
            np.copyto(nearest, 0, where=nearest == FARTHEST)
            carried = nearest.astype(np.uint16)
        return carried.reshape(self.lens.height, self.lens.width)

    def color(self, picture: UInt8[np.ndarray, "_ _ 3"]) -> UInt8[np.ndarray, "_ _ 3"]:
        """The colour picture without distortion.

        Raises:
            TornError: the picture has another size than its lens.
        """
        lens = self._rig.color or self._rig.depth
        _check_size(picture, lens)
        return lens.straighten(picture)


def _check_size(picture: np.ndarray, lens: Lens) -> None:
    height, width = picture.shape[:2]
    if (width, height) != lens.size:
        raise TornError(
            f"a picture of {width} x {height} pixels, but the intrinsics are for {lens.width} x "
            f"{lens.height}; give those of this size with --intrinsics FILE"
        )
