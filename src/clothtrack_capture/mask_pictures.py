"""Pictures of masks: the cloth in its own colors with an outline, everything else dimmed."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from clothtrack.files.atomic_write import write_file
from clothtrack.recordings.pictures import encode_png
from clothtrack.report.palette import HIDDEN, PAPER, Picture, caption, rgb255
from clothtrack_capture.segmentation_setup import SegmentationSetup

_JPEG_QUALITY = 88
_COLUMNS, _ROWS = 5, 4
"""Columns and largest number of rows of a contact sheet."""
_WIDTH = 300
"""Width of one picture in the sheet [pixels]."""


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
