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
from clothtrack_capture.importing.intrinsics import StereoCalibration
from clothtrack_capture.importing.units import DepthUnit

Content = np.ndarray | PackedPicture  # pixels, or an encoded file of them


def natural_order(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts names by the numbers in them."""
    parts = re.split(r"(\d+)", name)
    return [(int(part[:18]), "") if part.isdigit() else (-1, part) for part in parts]


def listed(names: Sequence[str], most: int = 8) -> str:
    """Return the names as text, the first of many."""
    more = [f"and {len(names) - most} more"] if len(names) > most else []
    return ", ".join([*names[:most], *more])


# The options that name something in a bag.
TOPIC_OPTIONS = ("depth_topic", "color_topic", "world_frame", "picker_topic", "picker_frame",
                 "gripper_topic", "gripper_joints", "gripper_closed_below")  # fmt: skip


def flag(name: str) -> str:
    """Return the name of an option as it is typed."""
    return f"--{name.replace('_', '-')}"


def unused(options: ImportOptions, why: str, *names: str) -> list[str]:
    """Return a remark on the options among these that were given and do not apply."""
    given = [flag(name) for name in names if getattr(options, name)]
    return [f"{', '.join(given)} not used: this source {why}"] if given else []


@dataclass(frozen=True, slots=True)
class StreamFrame:
    """One picture: its time stamp (or else its time of writing) and its place in the source."""

    time_ns: int
    place: Any
    written_ns: int | None = None
    stamped: bool = True


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
