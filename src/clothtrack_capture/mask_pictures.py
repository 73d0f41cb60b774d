"""Masks to look at: pictures of them, how much of the pictures is cloth, and what is doubtful."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.files.atomic_write import write_file
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import encode_png, read_mask
from clothtrack.recordings.recording import Recording
from clothtrack.report.lettering import Picture, caption
from clothtrack.report.palette import HIDDEN, PAPER, rgb255
from clothtrack_capture.segmentation_setup import SegmentationSetup

_JPEG_QUALITY = 88
_COLUMNS, _ROWS = 5, 4
"""Columns and largest number of rows of a contact sheet."""
_WIDTH = 300
"""Width of one picture in the sheet [pixels]."""

NEIGHBORS = 5
"""Number of masks before and after a mask whose median area it is compared with."""

_SUDDEN = 0.25
"""Share by which a mask's area may differ from those around it. A cloth that is folded or lifted
changes its area slowly, so a larger difference means a lost piece or an added object."""

_LISTED = 8
"""Largest number of frames that a line lists."""


def masked_picture(
    color: UInt8[np.ndarray, "rows columns 3"],
    mask: Bool[np.ndarray, "rows columns"] | None,
    *,
    width: int,
) -> Picture:
    """Return the picture scaled to this width [pixels], with the mask, if any, drawn on it."""
    height = max(1, round(color.shape[0] * width / color.shape[1]))
    size = width, height
    small = cv2.resize(color, size, interpolation=cv2.INTER_AREA)
    if mask is None:
        return small
    inside = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    gray = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)[..., None]
    calm = (0.35 * gray + 0.65 * np.array(rgb255(PAPER))).astype(np.uint8)
    shown = np.where(inside[..., None] > 0, small, calm)
    outlines, _ = cv2.findContours(inside, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(shown, outlines, -1, rgb255(HIDDEN), 1 if width < 400 else 2, cv2.LINE_AA)
    return shown


def jpeg(picture: Picture) -> bytes:
    """Return a picture encoded as JPEG."""
    flags = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    return cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), flags)[1].tobytes()


def spread(frames: Sequence[int], count: int) -> list[int]:
    """Return at most `count` of the frames, evenly spaced from the first to the last."""
    places = np.unique(np.linspace(0, len(frames) - 1, count).round().astype(int))
    return [frames[place] for place in places]


def write_mask_sheet(setup: SegmentationSetup, path: Path) -> Path:
    """Write a contact sheet of masks from the whole recording as a PNG."""
    cells = []
    for index in spread([frame.index for frame in setup.frames], _COLUMNS * _ROWS):
        mask = setup.mask(index)
        share = "no mask" if mask is None else f"{100 * mask.mean():.1f} %"
        shown = masked_picture(setup.picture(index), mask, width=_WIDTH)
        cells.append(np.concatenate([shown, caption(_WIDTH, f"frame {index}", share, height=24)]))
    blank = np.full_like(cells[0], rgb255(PAPER))
    cells += [blank] * (-len(cells) % _COLUMNS)
    strips = [
        np.concatenate(cells[place : place + _COLUMNS], axis=1)
        for place in range(0, len(cells), _COLUMNS)
    ]
    write_file(path, encode_png(np.concatenate(strips)))
    return path


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
