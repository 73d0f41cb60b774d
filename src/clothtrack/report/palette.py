"""The colors of all pictures and pages, with one hue per meaning, and text on pictures.

Colors are RGB in 0..1 (float) for shading; `hexadecimal` converts them for style sheets.
"""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

Picture = UInt8[np.ndarray, "height width 3"]

_FONT = cv2.FONT_HERSHEY_SIMPLEX

OUTSIDE = (0.290, 0.490, 0.690)
"""The outer side of the cloth (its front faces)."""
INSIDE = (0.878, 0.643, 0.345)
"""The inner side; inside an outer region it shows a layer pushed through another."""
HIDDEN = (0.765, 0.318, 0.498)
"""Parts that no camera sees, estimated by the tracker."""
OBSERVED = (0.110, 0.478, 0.427)
"""The measured points."""
PICKER_CLOSED = (0.851, 0.275, 0.196)
"""A picker that holds cloth."""
PICKER_OPEN = (0.431, 0.604, 0.424)
"""A picker that is open."""
PAPER = (0.965, 0.957, 0.941)
"""Background of the stills."""
TABLE = (0.902, 0.886, 0.859)
"""The table."""
INK = (0.149, 0.157, 0.180)
"""Text and lines."""
UNKNOWN = (0.620, 0.612, 0.596)
"""Unknown values."""

HEAT = np.array(
    [
        [0.267, 0.412, 0.580],
        [0.373, 0.620, 0.659],
        [0.741, 0.796, 0.584],
        [0.933, 0.780, 0.416],
        [0.890, 0.510, 0.286],
        [0.690, 0.204, 0.220],
    ]
)
"""Stops of the color scale for graded values, from low to high."""


def heat(values: Float[np.ndarray, " values"], limit: float) -> Float[np.ndarray, "values 3"]:
    """Return a color for each value from 0 (blue) to `limit` and above (red)."""
    place = np.clip(np.nan_to_num(values / limit, nan=0.0), 0.0, 1.0) * (len(HEAT) - 1)
    stops = np.arange(len(HEAT))
    return np.stack([np.interp(place, stops, channel) for channel in HEAT.T], axis=-1)


def rgb255(color: tuple[float, float, float]) -> tuple[int, int, int]:
    """Return a color as three numbers from 0 to 255."""
    red, green, blue = (round(255 * channel) for channel in color)
    return red, green, blue


def hexadecimal(color: tuple[float, float, float]) -> str:
    """Return a color in style-sheet notation (`#4a7db0`)."""
    return "#{:02x}{:02x}{:02x}".format(*rgb255(color))


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
