"""How much of the pictures is cloth, and which masks are to be doubted."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack_capture.segmentation_setup import SegmentationSetup

NEIGHBORS = 5
"""A mask is compared with the median of so many before and so many after it."""

_SUDDEN = 0.25
"""A cloth that is folded or lifted changes its area slowly; a mask that differs from those around
it by more than this share has lost a piece, or gained something that is no cloth."""

_LISTED = 8
"""Most frames that a line names."""


@dataclass(frozen=True)
class MaskSummary:
    """The masks of a recording, counted.

    Attributes:
        frames: how many have cloth in them.
        pixels: of cloth in the frame in the middle, by size.
        least_share: of the smallest mask in its picture.
        most_share: of the largest one.
        smallest_frame: where the smallest is.
        doubtful: frames without any cloth, or with much less or more than those around them.
    """

    frames: int
    pixels: int
    least_share: float
    most_share: float
    smallest_frame: int
    doubtful: tuple[int, ...]

    def __str__(self) -> str:
        """Return two lines for a person."""
        low, high = 100 * self.least_share, 100 * self.most_share
        text = (
            f"{self.frames} frames with cloth, {low:.1f} to {high:.1f} % of the picture (median "
            f"{self.pixels} pixels); smallest in frame {self.smallest_frame}"
        )
        if not self.doubtful:
            return f"{text}\nno frame is doubtful: the area changes slowly everywhere"
        named = ", ".join(map(str, self.doubtful[:_LISTED]))
        more = f" and {len(self.doubtful) - _LISTED} more" if len(self.doubtful) > _LISTED else ""
        return f"{text}\nlook at frames {named}{more}: much less or more cloth than around them"

    def as_dict(self) -> dict[str, Any]:
        """Return the summary for a program."""
        return asdict(self)


def summary_of(setup: SegmentationSetup) -> MaskSummary:
    """Count the masks of all frames.

    Raises:
        InvalidRecordingError: a picture cannot be read.
    """
    masks = [setup.mask(frame.index) for frame in setup.frames]
    areas = np.array([0 if mask is None else int(mask.sum()) for mask in masks], float)
    filled = np.flatnonzero(areas > 0)
    if not len(filled):
        return MaskSummary(0, 0, 0.0, 0.0, setup.frames[0].index, _indices(setup, areas < 1))
    shares = areas / (setup.camera.width * setup.camera.height)
    smallest = int(filled[np.argmin(areas[filled])])
    return MaskSummary(
        frames=len(filled),
        pixels=int(np.median(areas[filled])),
        least_share=float(shares[smallest]),
        most_share=float(shares.max()),
        smallest_frame=setup.frames[smallest].index,
        doubtful=_indices(setup, doubtful(areas)),
    )


def doubtful(areas: Float[np.ndarray, " frames"]) -> np.ndarray:
    """Return which of the areas [pixels] are empty, or differ suddenly from those around them."""
    padded = np.pad(areas, NEIGHBORS, mode="edge")
    around = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBORS + 1), axis=1)
    return (areas < 1) | (np.abs(areas - around) > _SUDDEN * around)


def _indices(setup: SegmentationSetup, chosen: np.ndarray) -> tuple[int, ...]:
    return tuple(frame.index for frame, one in zip(setup.frames, chosen, strict=True) if one)
