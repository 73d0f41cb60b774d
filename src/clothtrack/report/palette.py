"""The colors of all pictures and pages, with one hue per meaning.

Colors are RGB in 0..1 (float) for shading; `hexadecimal` converts them for style sheets.
"""

import numpy as np
from jaxtyping import Float

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
