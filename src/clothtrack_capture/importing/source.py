"""What every source of recordings offers, whatever its format."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from clothtrack.recordings.recording import PickerPath
from clothtrack_capture.importing.intrinsics import Intrinsics
from clothtrack_capture.importing.packed_pictures import PackedPicture

# Pixels, or the file that holds them.
Content = np.ndarray | PackedPicture


def natural_order(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts names by the numbers in them."""
    parts = re.split(r"(\d+)", name)
    return [(int(part[:18]), "") if part.isdigit() else (-1, part) for part in parts]


@dataclass(frozen=True, slots=True)
class StreamFrame:
    """One picture: when it was taken on the source's clock [ns], and where the source has it."""

    time_ns: int
    place: Any


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """The intrinsics of a depth camera's two sensors and how the sensors stand to each other.

    Attributes:
        depth: intrinsics of the depth pictures.
        color: intrinsics of the color pictures, or None without color.
        color_from_depth: rigid transform, depth camera to color camera [m].
        depth_unit_m: meters per unit of the depth pictures.
        unit_origin: where the unit comes from, in words.
    """

    depth: Intrinsics
    color: Intrinsics | None
    color_from_depth: Float[np.ndarray, "4 4"]
    depth_unit_m: float
    unit_origin: str

    @property
    def registered(self) -> bool:
        """Whether the same pixel of both pictures shows the same point already."""
        if self.color is None:
            return True
        standing = np.abs(self.color_from_depth - np.eye(4)).max() < 1e-6
        return bool(standing and self.depth.same_pixels(self.color))


@dataclass(frozen=True, eq=False)
class Streams:
    """What a source holds.

    Attributes:
        kind: the format in words ("ROS 1 bag").
        calibration: intrinsics and unit of depth.
        depth: every whole depth picture.
        color: every whole color picture; None without a color stream.
        origins: which topic, track or folder each thing came from.
        notes: what was lost or left out, in words.
        paths: where pickers were, in `path_frame`; times [s] count from `path_start_ns`.
        path_frame: name of the frame of `paths`, in words.
        path_start_ns: zero of their times on the clock of the pictures [ns].
        world_from_camera: pose of the camera that the recording will have, when the source knows.
    """

    kind: str
    calibration: StereoCalibration
    depth: Sequence[StreamFrame]
    color: Sequence[StreamFrame] | None
    origins: Mapping[str, str]
    notes: Sequence[str] = ()
    paths: Mapping[str, PickerPath] = field(default_factory=dict)
    path_frame: str = ""
    path_start_ns: int = 0
    world_from_camera: Float[np.ndarray, "4 4"] | None = None


@runtime_checkable
class Source(Protocol):
    """An opened source. `depth` and `color` take bytes now; what they return does the work."""

    @property
    def streams(self) -> Streams:
        """What the source holds."""
        ...

    def depth(self, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that gives the counts of a depth picture.

        May be called in another thread.

        Raises:
            TruncatedError: the bytes are not there (or, by the function, no picture).
        """
        ...

    def color(self, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that gives red, green and blue; may be called in another thread.

        Raises:
            TruncatedError: the bytes are not there (or, by the function, no picture).
        """
        ...

    def close(self) -> None:
        """Let go of the files."""
        ...
