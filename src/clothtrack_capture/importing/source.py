"""What every source of a recording tells, and how its pictures are fetched."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from clothtrack.recordings.recording import PickerPath
from clothtrack_capture.importing.images import PackedPicture
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.intrinsics import Intrinsics
from clothtrack_capture.importing.units import DepthUnit

# Pixels, or an encoded file of them.
Content = np.ndarray | PackedPicture


def natural_order(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts names by the numbers in them."""
    parts = re.split(r"(\d+)", name)
    return [(int(part[:18]), "") if part.isdigit() else (-1, part) for part in parts]


def listed(names: Sequence[str], most: int = 8) -> str:
    """Return the names as text, the first of many."""
    more = [f"and {len(names) - most} more"] if len(names) > most else []
    return ", ".join([*names[:most], *more])


TOPIC_OPTIONS = ("depth_topic", "color_topic", "world_frame", "picker_topic", "picker_frame",
                 "gripper_topic", "gripper_joints", "gripper_closed_below")  # fmt: skip
"""The options that name something in a bag."""


def unused(options: ImportOptions, why: str, *names: str) -> list[str]:
    """Return a remark on the options among these that were given and do not apply."""
    given = [f"--{name.replace('_', '-')}" for name in names if getattr(options, name)]
    return [f"{', '.join(given)} not used: this source {why}"] if given else []


@dataclass(frozen=True, slots=True)
class StreamFrame:
    """One picture: its time stamp (or else its time of writing) and its place in the source."""

    time_ns: int
    place: Any
    written_ns: int | None = None
    stamped: bool = True


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """The intrinsics and the relative pose [m] of a depth camera's two sensors."""

    depth: Intrinsics
    color: Intrinsics | None
    color_from_depth: Float[np.ndarray, "4 4"]
    origin: str

    @property
    def registered(self) -> bool:
        """Whether the same pixel of both pictures already shows the same point."""
        if self.color is None:
            return True
        standing = np.abs(self.color_from_depth - np.eye(4)).max() < 1e-6
        return bool(standing and self.depth.same_pixels(self.color))


@dataclass(frozen=True, eq=False)
class Streams:
    """The content of a source; what is not known is None.

    Pictures stand in the order of writing; a mask belongs to the pictures of its time. `paths` are
    in `path_frame`, their times [s] count from `path_start_ns` on the clock of the pictures.
    `marks` has the stamps of the robot's messages, by topic; `ask_unit` is the message where nobody
    tells the unit.
    """

    kind: str
    calibration: StereoCalibration
    unit: DepthUnit | None
    ask_unit: str
    depth: Sequence[StreamFrame]
    color: Sequence[StreamFrame] | None
    origins: Mapping[str, str]
    mask: Sequence[StreamFrame] = ()
    marks: Mapping[str, Sequence[StreamFrame]] = field(default_factory=dict)
    notes: Sequence[str] = ()
    paths: Mapping[str, PickerPath] = field(default_factory=dict)
    path_frame: str = ""
    path_start_ns: int = 0
    world_from_camera: Float[np.ndarray, "4 4"] | None = None


@runtime_checkable
class Source(Protocol):
    """An opened source; a picture's bytes are read at once and decoded by what is returned."""

    @property
    def streams(self) -> Streams:
        """Content of the source."""
        ...

    def picture(self, kind: str, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes a picture of "depth", "color" or "mask", in any thread."""
        ...

    def close(self) -> None:
        """Close the files."""
        ...
