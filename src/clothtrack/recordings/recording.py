"""A recording in memory: cameras, frames, actions and the picker's path; pictures stay on disk."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh


@dataclass(frozen=True, eq=False)
class Table:
    """The plane that the cloth lies on: a point of it [m] and its unit normal, pointing up."""

    point: Float[np.ndarray, " 3"]
    normal: Float[np.ndarray, " 3"]

    def heights(self, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, " points"]:
        """Return signed distance of points above the table [m]."""
        return (points - self.point) @ self.normal


def not_up(normal: Float[np.ndarray, " 3"]) -> str:
    """Return why a table's unit normal does not point up, and what to do; empty where it does.

    A table that stands within 30 degrees of upright is that of a world with another axis up.
    """
    axis = int(np.argmax(np.abs(normal)))
    if axis != 2 and abs(normal[axis]) > np.cos(np.radians(30)):
        up, turned = {
            (0, True): ("x", "(y, z, x)"), (0, False): ("-x", "(z, y, -x)"),
            (1, True): ("y", "(x, -z, y)"), (1, False): ("-y", "(x, z, -y)"),
        }[axis, bool(normal[axis] > 0)]  # fmt: skip
        problem = f"the world has {up} up, and gravity acts along z here"
        where = "table, rows of world_from_camera, picker.csv, template and clouds"
        return f"{problem}; turn the world: write {turned} for (x, y, z) in {where}"
    if normal[2] <= 0:
        return "it points down; the world's z axis points up; turn it around"
    return ""


@dataclass(frozen=True)
class Frame:
    """One moment: when it was and which files show it. Paths are absolute.

    Attributes:
        index: number of the frame in the recording, from 0.
        time_s: time since the start [s].
        color: colour picture per camera name.
        depth: depth picture per camera name.
        mask: mask of the cloth per camera name, when the recording has one.
        cloud: point cloud of the whole moment, when the recording has one.
    """

    index: int
    time_s: float
    color: Mapping[str, Path] = field(default_factory=dict)
    depth: Mapping[str, Path] = field(default_factory=dict)
    mask: Mapping[str, Path] = field(default_factory=dict)
    cloud: Path | None = None


@dataclass(frozen=True)
class PickAndPlace:
    """One action: between which frames, and by which pickers. `last_frame` belongs to it."""

    first_frame: int
    last_frame: int
    pickers: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class PickerPath:
    """Where a picker's tip was, and when it was closed.

    Attributes:
        time_s: sample times [s], strictly increasing.
        positions: tip positions in the world [m].
        closed: whether the picker was closed from this sample to the next.
    """

    time_s: Float[np.ndarray, " samples"]
    positions: Float[np.ndarray, "samples 3"]
    closed: Bool[np.ndarray, " samples"]

    def position_at(self, time_s: float) -> Float[np.ndarray, " 3"]:
        """Return the tip position [m], linear between samples, constant beyond the ends."""
        return np.array([np.interp(time_s, self.time_s, axis) for axis in self.positions.T])

    def closed_at(self, time_s: float) -> bool:
        """Return whether the picker is closed at this time."""
        sample = int(np.searchsorted(self.time_s, time_s + 1e-9, side="right")) - 1
        return bool(self.closed[max(sample, 0)])


@dataclass(frozen=True, eq=False)
class ClothDescription:
    """What is known of the cloth before tracking.

    Attributes:
        kind: "towel", "tshirt", "trousers" or "other".
        color: a named colour for segmentation ("blue"), or None.
        size_m: side lengths (width, length) of the flat cloth [m] when measured.
        template: the first mesh, in the world frame, when the recording carries one.
        held_vertices: template vertices that each picker holds, when known.
        grasp_uncertainty_m: how far the held cloth may be from the recorded tip [m]: 0 when the
            path was measured, a few centimetres when it is only what the robot was told.
    """

    kind: str = "other"
    color: str | None = None
    size_m: tuple[float, float] | None = None
    template: ClothMesh | None = None
    held_vertices: Mapping[str, Int[np.ndarray, " held"]] = field(default_factory=dict)
    grasp_uncertainty_m: float = 0.0


@dataclass(frozen=True)
class ObservedRegion:
    """Where the sensor's data was cut away, so that no cloth there means nothing.

    Attributes:
        lowest_height_m: world height [m] under which points were removed, or None.
        tool_clearance_m: radius around every picker tip [m] within which points were removed.
    """

    lowest_height_m: float | None = None
    tool_clearance_m: float = 0.0


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording in the format of docs/data_format.md, read and validated.

    Attributes:
        folder: where it lies.
        cameras: every camera, in the file's order.
        depth_units_m: metres per unit of the 16-bit depth pictures, per camera name.
        frames: in order of time.
        actions: pick-and-places, in order, not overlapping.
        picker_paths: path per picker name.
        table: the table, or None when the cloth hangs.
        cloth: what is known of the cloth.
        observed: where the data was cut away.
        provenance: who made it, how; free text and numbers.
    """

    folder: Path
    cameras: tuple[Camera, ...]
    depth_units_m: Mapping[str, float]
    frames: tuple[Frame, ...]
    actions: tuple[PickAndPlace, ...]
    picker_paths: Mapping[str, PickerPath]
    table: Table | None = None
    cloth: ClothDescription = field(default_factory=ClothDescription)
    observed: ObservedRegion = field(default_factory=ObservedRegion)
    provenance: Mapping[str, object] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.name
