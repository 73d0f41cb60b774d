"""Sets of the colors of cloth, looked up by the five highest bits of each channel.

A set is a table of 32 x 32 x 32 entries, so a printed cloth with twenty colors costs as much as a
plain one: one look-up per pixel.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8, UInt16
from scipy.ndimage import gaussian_filter, maximum_filter

from clothtrack.recordings.pictures import bands

BINS = 32
NO, LOOSE, CORE = 0, 1, 2

_LEAST_SATURATION = 0.2
"""Saturation (0 to 1) from which a color is recognized in other light."""

_LEAST_VALUE = 0.1
"""Value (0 to 1) below which a color has no usable hue."""


@dataclass(frozen=True)
class ColorRange:
    """A range of hue, saturation and value.

    Attributes:
        hue: from and to [degrees]; from > to runs through 0 (red).
        saturation: from and to, 0 (gray) to 1.
        value: from and to, 0 (black) to 1.
    """

    hue: tuple[float, float] = (0.0, 360.0)
    saturation: tuple[float, float] = (0.3, 1.0)
    value: tuple[float, float] = (0.17, 1.0)

    def widened(self) -> "ColorRange":
        """Return the range with a margin for shade, gloss and white balance."""
        low, high = self.hue
        if low <= high and high - low >= 336:
            hue = (0.0, 360.0)
        else:
            hue = ((low - 12) % 360, (high + 12) % 360)
        return ColorRange(hue, _spread(self.saturation, 0.1), _spread(self.value, 0.08))

    def contains(self, hsv: Float[np.ndarray, "*any 3"]) -> Bool[np.ndarray, "*any"]:
        """Return whether colors lie in the range; hue [degrees], saturation and value 0 to 1."""
        hue, saturation, value = np.moveaxis(hsv, -1, 0)
        low, high = self.hue
        turned = (hue >= low) & (hue <= high) if low <= high else (hue >= low) | (hue <= high)
        for channel, (least, most) in ((saturation, self.saturation), (value, self.value)):
            turned = turned & (channel >= least) & (channel <= most)
        return turned


NAMED_COLORS: Mapping[str, tuple[ColorRange, ...]] = MappingProxyType(
    {
        "red": (ColorRange((345.0, 14.0)),),
        "orange": (ColorRange((14.0, 42.0), value=(0.5, 1.0)),),
        "yellow": (ColorRange((42.0, 70.0)),),
        "green": (ColorRange((70.0, 165.0)),),
        "cyan": (ColorRange((165.0, 200.0)),),
        "blue": (ColorRange((200.0, 260.0)),),
        "purple": (ColorRange((260.0, 300.0)),),
        "pink": (
            ColorRange((300.0, 345.0)),
            ColorRange((345.0, 14.0), saturation=(0.15, 0.5), value=(0.7, 1.0)),
        ),
        "brown": (ColorRange((8.0, 45.0), value=(0.12, 0.6)),),
        "white": (ColorRange(saturation=(0.0, 0.18), value=(0.6, 1.0)),),
        "gray": (ColorRange(saturation=(0.0, 0.2), value=(0.2, 0.75)),),
        "grey": (ColorRange(saturation=(0.0, 0.2), value=(0.2, 0.75)),),
        "black": (
            ColorRange(saturation=(0.0, 0.35), value=(0.0, 0.25)),
            ColorRange(saturation=(0.0, 1.0), value=(0.0, 0.12)),
        ),
    }
)


@lru_cache
def named_set(name: str) -> UInt8[np.ndarray, "32 32 32"]:
    """Return the set of colors with a name: `CORE` inside its range, `LOOSE` near it."""
    hsv = _all_hsv().reshape(BINS, BINS, BINS, 3)
    ranges = NAMED_COLORS[name.lower()]
    members = np.zeros(hsv.shape[:3], dtype=np.uint8)
    for chosen in ranges:
        members[chosen.widened().contains(hsv) & (members == NO)] = LOOSE
    for chosen in ranges:
        members[chosen.contains(hsv)] = CORE
    members.setflags(write=False)
    return members


def learned_set(
    color: UInt8[np.ndarray, "height width 3"],
    cloth: Bool[np.ndarray, "height width"],
    other: Bool[np.ndarray, "height width"],
) -> UInt8[np.ndarray, "32 32 32"]:
    """Return the set of colors that are more frequent on the cloth than elsewhere.

    Two smoothed histograms are compared bin by bin (a likelihood ratio): `CORE` where cloth is
    three times as frequent, `LOOSE` where it is more frequent.
    """
    bins = bin_of(color)
    inside, outside = (
        gaussian_filter(
            np.bincount(bins[chosen], minlength=BINS**3).reshape((BINS,) * 3).astype(np.float32),
            0.8,
            mode="nearest",
        )
        for chosen in (cloth, other)
    )
    seen = inside > 1e-5 * max(int(cloth.sum()), 1)
    members = np.zeros((BINS,) * 3, dtype=np.uint8)
    members[seen & (inside > outside)] = LOOSE
    members[seen & (inside > 3 * outside)] = CORE
    return members


def with_shades(
    members: UInt8[np.ndarray, "32 32 32"],
    color: UInt8[np.ndarray, "height width 3"],
    cloth: Bool[np.ndarray, "height width"],
) -> UInt8[np.ndarray, "32 32 32"]:
    """Return the set extended by the same colors in other light, as in folds of the cloth.

    Light changes the value of a color, but not its hue and saturation. Colors of the rest of the
    picture are not added, and neither are grays, which have no hue.
    """
    hsv = _all_hsv()
    bins = bin_of(color)
    own = cloth & (members.ravel()[bins] == CORE)
    # Use the pixels themselves, because five bits of a dark color say little about its hue.
    seen = cv2.cvtColor(color[own][None].astype(np.float32) / 255.0, cv2.COLOR_RGB2HSV)[0]
    outside = np.bincount(bins[~cloth], minlength=BINS**3)
    tints = np.zeros((36, 10))
    np.add.at(tints, _tint(seen[seen[:, 1] >= _LEAST_SATURATION]), 1)
    known = tints > 0.002 * max(len(seen), 1)
    # Neighbors in hue or saturation are the same color, because five bits have such wide steps.
    known = maximum_filter(known, size=3, mode=("wrap", "nearest"))
    shade = (
        np.asarray(known, bool)[_tint(hsv)]
        & (hsv[:, 1] >= _LEAST_SATURATION)
        & (hsv[:, 2] >= _LEAST_VALUE)
    )
    foreign = gaussian_filter(outside.reshape((BINS,) * 3).astype(np.float32), 0.8).ravel() > 1.0
    widened = np.where(shade & ~foreign, CORE, members.ravel())
    return widened.reshape(members.shape).astype(np.uint8)


def votes_of(
    color: UInt8[np.ndarray, "height width 3"], members: UInt8[np.ndarray, "32 32 32"]
) -> UInt8[np.ndarray, "height width"]:
    """Return the vote of a set of colors on every pixel: `CORE`, `LOOSE` or `NO`."""
    table = members.ravel()
    votes = np.empty(color.shape[:2], dtype=np.uint8)
    for rows in bands(len(color)):
        votes[rows] = table.take(bin_of(color[rows]))
    return votes


def bin_of(
    color: UInt8[np.ndarray, "height width 3"],
) -> UInt16[np.ndarray, "height width"]:
    """Return the index of the table entry of every pixel."""
    # OpenCV packs five bits per channel in one pass; its blue is our red.
    return cv2.cvtColor(color, cv2.COLOR_RGB2BGR555).view(np.uint16)[..., 0]


def _all_hsv() -> Float[np.ndarray, "colors 3"]:
    """Return hue [degrees], saturation and value of every table entry."""
    levels = np.arange(BINS, dtype=np.float32) / (BINS - 1)
    rgb = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1)
    return cv2.cvtColor(rgb.reshape(1, -1, 3), cv2.COLOR_RGB2HSV)[0]


def _tint(hsv: Float[np.ndarray, "colors 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Return the step of hue (ten degrees) and of saturation (a tenth) of every color."""
    return (hsv[:, 0] // 10).astype(int) % 36, np.minimum((hsv[:, 1] * 10).astype(int), 9)


def _spread(bounds: tuple[float, float], margin: float) -> tuple[float, float]:
    return max(bounds[0] - margin, 0.0), min(bounds[1] + margin, 1.0)
