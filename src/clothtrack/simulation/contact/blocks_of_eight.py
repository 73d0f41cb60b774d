"""Blocks of eight neighboring triangles, edges or vertices of one cloth, with bounding boxes.

Contact tests eight boxes at once (`geometry.boxes`). Neighbors in the rest shape stay neighbors,
because they belong to one cloth. The order is therefore computed once, and a search only refits the
boxes.
"""

from typing import no_type_check

import numpy as np
import warp as wp
from jaxtyping import Float, Int, Int32

from clothtrack.geometry.boxes import EIGHT, along_curve, around_eight, blocks, no_boxes, put_box
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.buffers import ClothBuffers
from clothtrack.simulation.kernels import nth

wp.set_module_options({"enable_backward": False})

_EIGHT = wp.constant(EIGHT)


class Eights:
    """All triangles or all edges of a cloth in blocks of eight ("eights").

    Attributes:
        numbers: their indices (eights, 8); -1 for empty places of a block.
        corners: their vertices (eights, 3, 8), as `numbers`; an edge repeats its second vertex.
        around: boxes around each eight (environments, eights of eights, 6, 8) [m].
        top: boxes around each eight of eights (environments, eights of those, 6, 8) [m].
    """

    def __init__(
        self, mesh: ClothMesh, corners: Int[np.ndarray, "items 3"], buffers: ClothBuffers
    ) -> None:
        self._buffers = buffers
        self._device = device = buffers.positions.device
        environments = buffers.shape[0]
        numbers = in_eights(mesh.vertices[corners].mean(axis=1))
        by_eight = np.where(numbers[..., None] < 0, -1, corners[numbers]).astype(np.int32)
        by_eight = np.ascontiguousarray(by_eight.swapaxes(1, 2))
        self.numbers = wp.array(numbers, dtype=int, device=device)
        self.corners = wp.array(by_eight, dtype=int, device=device)
        around = blocks(len(numbers), EIGHT)
        self.around = wp.array(no_boxes(environments, around), dtype=float, device=device)
        top = blocks(around, EIGHT)
        self.top = wp.array(no_boxes(environments, top), dtype=float, device=device)

    @property
    def threads(self) -> int:
        """Number of threads that share the eights of an environment."""
        return self._buffers.threads(len(self.numbers))

    def fit_top(self) -> None:
        """Fit the boxes around eights of eights to those around eights."""
        environments, around = self.around.shape[:2]
        threads = self._buffers.threads(around)
        wp.launch(
            fit_top,
            dim=(environments, threads),
            inputs=[threads, self.around],
            outputs=[self.top],
            device=self._device,
        )


def in_eights(points: Float[np.ndarray, "points 3"]) -> Int32[np.ndarray, "eights 8"]:
    """Return point indices in blocks of 8 along a Morton curve, padded with -1."""
    numbers = np.full(EIGHT * blocks(len(points), EIGHT), -1, np.int32)
    numbers[: len(points)] = along_curve(points)
    return numbers.reshape(-1, EIGHT)


@no_type_check
@wp.kernel
def fit_top(
    stride: int,
    around: wp.array4d(dtype=float),
    top: wp.array4d(dtype=float),
):
    """Compute the box around each eight of boxes."""
    environment, thread = wp.tid()
    for number in range(thread, around.shape[1], stride):
        block = nth(number)
        whole = around_eight(around[environment], block)
        put_box(whole, top[environment], block // _EIGHT, block % _EIGHT)
