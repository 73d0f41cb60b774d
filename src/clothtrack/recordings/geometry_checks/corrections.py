"""Corrections of findings, as values that a program can apply."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class ColorFlip:
    """Mirror every color picture: left and right, up and down, or both."""

    columns: bool
    rows: bool


@dataclass(frozen=True)
class ColorShift:
    """Move every color picture by whole pixels, to the right and down."""

    columns: int
    rows: int


@dataclass(frozen=True)
class ColorScale:
    """Enlarge every color picture about its middle by a factor."""

    factor: float


@dataclass(frozen=True)
class ColorTurn:
    """Turn every color picture about its middle, counterclockwise."""

    degrees: float


@dataclass(frozen=True)
class StreamDelay:
    """Take one stream of every frame from so many frames later (earlier if negative)."""

    stream: Literal["color", "depth"]
    frames: int


@dataclass(frozen=True)
class ClockScale:
    """Multiply all times, those of the frames and of picker.csv, by a factor."""

    factor: float


@dataclass(frozen=True)
class PickerDelay:
    """Add so many seconds to the times of picker.csv."""

    seconds: float


@dataclass(frozen=True)
class LensDistortion:
    """Undistort color, depth and masks by the radial coefficient k1 (Brown, as OpenCV has it)."""

    k1: float


Correction = (
    ColorFlip
    | ColorShift
    | ColorScale
    | ColorTurn
    | StreamDelay
    | ClockScale
    | PickerDelay
    | LensDistortion
)
