"""A summary of masks: how much of the pictures is cloth, and which masks are doubtful."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import read_mask
from clothtrack.recordings.recording import Recording

NEIGHBORS = 5
"""Number of masks before and after a mask whose median area it is compared with."""

_SUDDEN = 0.25
"""Share by which a mask's area may differ from those around it. A cloth that is folded or lifted
changes its area slowly, so a larger difference means a lost piece or an added object."""

_LISTED = 8
"""Largest number of frames that a line lists."""


@dataclass(frozen=True)
class MaskSummary:
    """Statistics of the masks of a recording.

    Attributes:
        pixels: median number of cloth pixels per frame with cloth.
        least_share: share of the picture covered by the smallest mask.
        most_share: share of the picture covered by the largest mask.
        doubtful: frames without any cloth, or with much less or more cloth than those around them.
    """

    frames: int
    pixels: int
    least_share: float
    most_share: float
    smallest_frame: int
    doubtful: tuple[int, ...]

    def __str__(self) -> str:
        """Return the summary as two lines of text."""
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
        """Return the summary as a dictionary."""
        return asdict(self)


def summary_of(recording: Recording, camera: Camera) -> MaskSummary:
    """Count the masks of all frames with a color picture; at least one has a mask."""
    frames = [frame for frame in recording.frames if camera.name in frame.color]
    masks = [frame.mask.get(camera.name) for frame in frames]
    areas = np.array([0 if mask is None else int(read_mask(mask).sum()) for mask in masks], float)
    filled = np.flatnonzero(areas > 0)
    shares = areas / (camera.width * camera.height)
    smallest = int(filled[np.argmin(areas[filled])])
    return MaskSummary(
        frames=len(filled),
        pixels=int(np.median(areas[filled])),
        least_share=float(shares[smallest]),
        most_share=float(shares.max()),
        smallest_frame=frames[smallest].index,
        doubtful=tuple(frames[place].index for place in np.flatnonzero(doubtful(areas))),
    )


def doubtful(areas: Float[np.ndarray, " frames"]) -> np.ndarray:
    """Return which areas [pixels] are empty or differ suddenly from those around them."""
    padded = np.pad(areas, NEIGHBORS, mode="edge")
    around = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBORS + 1), axis=1)
    return (areas < 1) | (np.abs(areas - around) > _SUDDEN * around)
