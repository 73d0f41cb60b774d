"""The interface of all sources of recordings."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from clothtrack.recordings.recording import PickerPath
from clothtrack_capture.importing.intrinsics import Intrinsics
from clothtrack_capture.importing.packed_pictures import PackedPicture

# Pixels, or an encoded file of them.
Content = np.ndarray | PackedPicture


def natural_order(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts names by the numbers in them."""
    parts = re.split(r"(\d+)", name)
    return [(int(part[:18]), "") if part.isdigit() else (-1, part) for part in parts]


@dataclass(frozen=True, slots=True)
class StreamFrame:
    """One picture: its time on the source's clock [ns] and its position in the source."""

    time_ns: int
    place: Any


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """The intrinsics and relative pose of a depth camera's two sensors.

    Attributes:
        depth: intrinsics of the depth pictures.
        color: intrinsics of the color pictures; None without color.
        color_from_depth: rigid transform, depth camera to color camera [m].
        depth_unit_m: meters per unit of the depth pictures.
        unit_origin: origin of the unit, in words.
    """

    depth: Intrinsics
    color: Intrinsics | None
    color_from_depth: Float[np.ndarray, "4 4"]
    depth_unit_m: float
    unit_origin: str

    @property
    def registered(self) -> bool:
        """Whether the same pixel of both pictures already shows the same point."""
        if self.color is None:
            return True
        standing = np.abs(self.color_from_depth - np.eye(4)).max() < 1e-6
        return bool(standing and self.depth.same_pixels(self.color))


@dataclass(frozen=True, eq=False)
class Streams:
    """The content of a source.

    Attributes:
        kind: name of the format ("ROS 1 bag").
        calibration: intrinsics and depth unit.
        depth: all complete depth pictures.
        color: all complete color pictures; None without a color stream.
        origins: topic, track or folder that each item came from.
        notes: description of what was lost or left out.
        paths: picker paths in `path_frame`; times [s] count from `path_start_ns`.
        path_frame: description of the frame of `paths`.
        path_start_ns: zero of their times, on the clock of the pictures [ns].
        world_from_camera: pose of the recording's camera, if the source knows it.
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
    """An opened source; `depth` and `color` read bytes and return functions that decode them."""

    @property
    def streams(self) -> Streams:
        """Content of the source."""
        ...

    def depth(self, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes the counts of a depth picture."""
        ...

    def color(self, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes red, green and blue; it may be called in another thread.
        """
        ...

    def close(self) -> None:
        """Close the files."""
        ...
