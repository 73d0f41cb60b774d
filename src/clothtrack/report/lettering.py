"""Text and color scales on pictures, with OpenCV's stroke fonts."""

import cv2
import numpy as np
from jaxtyping import UInt8

from clothtrack.report.palette import INK, PAPER, heat, rgb255

Picture = UInt8[np.ndarray, "height width 3"]

_FONT = cv2.FONT_HERSHEY_SIMPLEX


def write(
    image: Picture,
    text: str,
    at: tuple[int, int],
    *,
    height_px: float = 12.0,
    color: tuple[float, float, float] = INK,
) -> None:
    """Write ASCII `text` into the image; `at` is the left end of its base line (column, row)."""
    scale = height_px / 21.0  # Hershey capitals are 21 pixels high at scale 1
    weight = 1 if height_px < 16 else 2
    cv2.putText(image, text, at, _FONT, scale, rgb255(color), weight, cv2.LINE_AA)


def text_width(text: str, *, height_px: float = 12.0) -> int:
    """Return the width of `text` [pixels]."""
    weight = 1 if height_px < 16 else 2
    (width, _), _ = cv2.getTextSize(text, _FONT, height_px / 21.0, weight)
    return int(width)


def caption(width: int, left: str, right: str = "", *, height: int = 30) -> Picture:
    """Return a strip with text at both ends; the right text is omitted if it does not fit."""
    strip = np.full((height, width, 3), rgb255(PAPER), dtype=np.uint8)
    size = 0.36 * height
    base = round(0.5 * height + 0.5 * size)
    write(strip, left, (10, base), height_px=size)
    room = width - 20 - text_width(left, height_px=size)
    if right and text_width(right, height_px=size) + 16 < room:
        write(strip, right, (width - 10 - text_width(right, height_px=size), base), height_px=size)
    return strip


def heat_legend(image: Picture, label: str, limit: float) -> None:
    """Draw the scale of `palette.heat` from 0 to `limit` at the lower left of the image."""
    height, width = image.shape[:2]
    bar_width, bar_height = max(60, width // 4), max(6, height // 50)
    left, top = 14, height - bar_height - 26
    colors = heat(np.linspace(0.0, 1.0, bar_width), 1.0)
    bar = image[top : top + bar_height, left : left + bar_width]
    bar[:] = np.rint(255 * colors).astype(np.uint8)[None, : bar.shape[1]]
    write(image, label, (left, top - 6), height_px=10.0)
    write(image, "0", (left, top + bar_height + 14), height_px=9.0)
    end = f"{limit:g}+"
    right = left + bar_width - text_width(end, height_px=9.0)
    write(image, end, (right, top + bar_height + 14), height_px=9.0)
