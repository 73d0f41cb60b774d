"""A recording: cameras, frames, actions and the picker's path.

Its pictures stay on disk, or in memory if a program passes them as arrays.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from operator import index
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8

from clothtrack._shown import html_table, short_repr
from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh

NEAREST_MEDIAN_M, FARTHEST_MEDIAN_M = 0.05, 20.0
"""Plausible limits of the median depth [m]; a wrong unit is off by a factor of ten."""

WRITTEN_UNIT_M = 1e-4
"""Unit in which depth in memory is written to 16-bit files [m]; its range is up to 6.5 m."""

_TYPES = {
    "depth": (np.floating, "give float meters, millimeters times 0.001"),
    "color": (np.uint8, "give uint8, red first"),
    "mask": (np.bool_, "give bool, True on the cloth: mask > 0"),
}
"""Required type of a picture in memory, and the remedy for another type."""

_CLOSE_S = 1e-3
# Seconds since 1970 have seven decimals in double precision.
_SAME_S = 1e-6


@dataclass(frozen=True, eq=False)
class Table:
    """The plane that the cloth lies on: a point of it [m] and its unit normal, pointing up."""

    point: Float[np.ndarray, " 3"]
    normal: Float[np.ndarray, " 3"]

    __repr__ = short_repr

    def heights(self, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, " points"]:
        """Return signed distance of points above the table [m]."""
        return (points - self.point) @ self.normal


def not_up(normal: Float[np.ndarray, " 3"]) -> str:
    """Return why this is no unit normal that points up, and what to do; empty if it is.

    A table within 30 degrees of vertical belongs to a world with another axis up.
    """
    length = float(np.linalg.norm(normal))
    if not abs(length - 1.0) < 1e-3:
        return f"its length is {length:.4g}, not 1; divide it by its length"
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
    """One frame: its time and its pictures, which are files (absolute paths) or arrays in memory.

    `recordings.pictures` reads both.

    Attributes:
        index: number of the frame in the recording, from 0.
        time_s: time since the start [s].
        depth: depth picture per camera name; in memory in meters.
        mask: mask of the cloth per camera name, when the recording has one.
        cloud: point cloud of the whole moment, when the recording has one.
    """

    index: int
    time_s: float
    color: Mapping[str, Path | UInt8[np.ndarray, "_ _ 3"]] = field(default_factory=dict)
    depth: Mapping[str, Path | Float32[np.ndarray, "_ _"]] = field(default_factory=dict)
    mask: Mapping[str, Path | Bool[np.ndarray, "_ _"]] = field(default_factory=dict)
    cloud: Path | Float[np.ndarray, "_ 3"] | None = None

    __repr__ = short_repr

    @classmethod
    def of_arrays(
        cls,
        index: int,
        time_s: float,
        camera: Camera,
        *,
        depth: np.ndarray,
        color: np.ndarray | None = None,
        mask: np.ndarray | None = None,
    ) -> "Frame":
        """Return a frame of one camera whose pictures are in memory.

        Args:
            time_s: time since the start [s].
            depth: (height, width) float, along the optical axis [m]; what is not positive and
                finite was not measured. It is copied.
        """
        name, given = camera.name, {"depth": depth, "color": color, "mask": mask}
        # OpenCV and checksums need whole rows, which img[..., ::-1] and transposes do not have.
        shown = {k: np.ascontiguousarray(one) for k, one in given.items() if one is not None}
        for kind, picture in shown.items():
            shape = (camera.height, camera.width, *((3,) if kind == "color" else ()))
            if picture.shape != shape:
                raise InvalidRecordingError(
                    f"frame {index}: {kind} has shape {picture.shape}, and camera {name!r} has "
                    f"{camera.width} x {camera.height} pixels: give {shape}, or correct the camera"
                )
            types, right = _TYPES[kind]
            if not np.issubdtype(picture.dtype, types):
                raise InvalidRecordingError(f"frame {index}: {kind} is {picture.dtype}; {right}")
        shown["depth"] = known = np.array(shown["depth"], np.float32, order="C")
        known[~((known > 0.0) & (known < np.inf))] = 0.0
        return cls(index, float(time_s), **{kind: {name: one} for kind, one in shown.items()})


@dataclass(frozen=True)
class PickAndPlace:
    """One action: its first and last frame (inclusive), and its pickers."""

    first_frame: int
    last_frame: int
    pickers: tuple[str, ...]


def actions_of(
    paths: "Mapping[str, PickerPath]", frame_times: Sequence[float]
) -> tuple[list[PickAndPlace], int]:
    """Return the actions in which a picker is closed, and the number of closures without one.

    An action begins with the last frame before a picker closes and ends with the first frame after
    it has opened. Pickers that are closed together share an action; an action needs two frames and
    a path that covers them.
    """
    times = np.asarray(frame_times)
    spans: list[tuple[int, int, set[str]]] = []
    left_out = 0
    for name, path in paths.items():
        first_known = int(np.searchsorted(times, path.time_s[0] - _CLOSE_S))
        last_known = int(np.searchsorted(times, path.time_s[-1] + _CLOSE_S, side="right")) - 1
        for start, stop in path.closures():
            first = max(int(np.searchsorted(times, start + _SAME_S, side="right")) - 1, first_known)
            last = min(int(np.searchsorted(times, stop - _SAME_S)), last_known)
            if last <= first:
                left_out += 1
                continue
            spans.append((first, last, {name}))
    merged: list[tuple[int, int, set[str]]] = []
    for first, last, names in sorted(spans, key=lambda span: span[:2]):
        if merged and first < merged[-1][1]:
            before, end, others = merged[-1]
            merged[-1] = (before, max(end, last), others | names)
        else:
            merged.append((first, last, names))
    actions = []
    for first, last, names in merged:
        covering = [name for name in sorted(names) if paths[name].covers(times[first], times[last])]
        if covering:
            actions.append(PickAndPlace(first, last, tuple(covering)))
        else:
            left_out += 1
    return actions, left_out


@dataclass(frozen=True, eq=False)
class PickerPath:
    """The path of a picker's tip, and when the picker was closed.

    Attributes:
        time_s: sample times [s], strictly increasing.
        positions: tip positions in the world [m].
        closed: whether the picker was closed from this sample to the next.
    """

    time_s: Float[np.ndarray, " samples"]
    positions: Float[np.ndarray, "samples 3"]
    closed: Bool[np.ndarray, " samples"]

    __repr__ = short_repr

    def position_at(self, time_s: float) -> Float[np.ndarray, " 3"]:
        """Return the tip position [m], linear between samples, constant beyond the ends."""
        return np.array([np.interp(time_s, self.time_s, axis) for axis in self.positions.T])

    def closed_at(self, time_s: float) -> bool:
        """Return whether the picker is closed at this time."""
        sample = int(np.searchsorted(self.time_s, time_s + 1e-9, side="right")) - 1
        return bool(self.closed[max(sample, 0)])

    def closures(self) -> list[tuple[float, float]]:
        """Return when the picker closed and when it had opened again [s]."""
        change = np.diff(np.concatenate([[0], self.closed.astype(np.int8), [0]]))
        opened = np.append(self.time_s, self.time_s[-1])
        starts, stops = np.flatnonzero(change > 0), np.flatnonzero(change < 0)
        return [
            (float(self.time_s[a]), float(opened[b])) for a, b in zip(starts, stops, strict=True)
        ]

    def covers(self, start_s: float, stop_s: float) -> bool:
        """Return whether the path is known between two times [s]."""
        return bool(self.time_s[0] <= start_s + _CLOSE_S and self.time_s[-1] >= stop_s - _CLOSE_S)


@dataclass(frozen=True, eq=False)
class ClothDescription:
    """What is known of the cloth before tracking.

    Attributes:
        kind: "towel", "tshirt", "trousers" or "other".
        color: a named color for segmentation ("blue"), or None.
        size_m: side lengths (width, length) of the flat cloth [m] when measured.
        template: the first mesh, in the world frame, when the recording carries one.
        held_vertices: template vertices that each picker holds, when known.
        grasp_uncertainty_m: how far the held cloth may be from the recorded tip [m]: 0 when the
            path was measured, a few centimeters when it is only the commanded path.
    """

    kind: str = "other"
    color: str | None = None
    size_m: tuple[float, float] | None = None
    template: ClothMesh | None = None
    held_vertices: Mapping[str, Int[np.ndarray, " held"]] = field(default_factory=dict)
    grasp_uncertainty_m: float = 0.0

    __repr__ = short_repr


@dataclass(frozen=True)
class ObservedRegion:
    """Regions where sensor data was cut away, so that missing cloth there means nothing.

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
        folder: its folder; only its name if it is in memory.
        cameras: every camera, in the file's order.
        depth_units_m: meters per unit of the 16-bit depth pictures, per camera name.
        frames: frames in order of time; frames and actions of a live recording grow.
        actions: pick-and-places, in order, not overlapping.
        picker_paths: path per picker name.
        table: the table, or None when the cloth hangs.
        cloth: what is known of the cloth.
        observed: where the data was cut away.
        provenance: who made it and how; free text and numbers.
    """

    folder: Path
    cameras: tuple[Camera, ...]
    depth_units_m: Mapping[str, float]
    frames: Sequence[Frame]
    actions: Sequence[PickAndPlace]
    picker_paths: Mapping[str, PickerPath]
    table: Table | None = None
    cloth: ClothDescription = field(default_factory=ClothDescription)
    observed: ObservedRegion = field(default_factory=ObservedRegion)
    provenance: Mapping[str, object] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.name

    @property
    def in_memory(self) -> bool:
        """Whether it is no folder's; its pictures are arrays, or files of another recording."""
        return not self.folder.is_absolute()

    def _facts(self) -> dict[str, object]:
        frames = self.frames
        seconds = frames[-1].time_s - frames[0].time_s if frames else 0.0
        kinds = ("color", "depth", "mask", "cloud")
        counts = {
            kind: sum(
                bool(f.cloud is not None if kind == "cloud" else getattr(f, kind)) for f in frames
            )
            for kind in kinds
        }
        return {
            "frames": f"{len(frames)} in {seconds:.2f} s",
            "pictures": ", ".join(f"{kind} {count}" for kind, count in counts.items() if count),
            "cameras": ", ".join(f"{c.name} {c.width} x {c.height}" for c in self.cameras),
            "actions": len(self.actions),
            "pickers": ", ".join(self.picker_paths),
            "table": self.table is not None,
            "cloth": self.cloth.kind,
        }

    def __repr__(self) -> str:
        """Return one line, without pictures and paths."""
        facts = ", ".join(f"{name}={value!r}" for name, value in self._facts().items())
        return f"Recording({self.name!r}, {facts})"

    def _repr_html_(self) -> str:
        return html_table(f"Recording {self.name}", self._facts())

    @classmethod
    def from_arrays(
        cls,
        depth: Sequence[np.ndarray] | np.ndarray,
        color: Sequence[np.ndarray] | np.ndarray | None,
        times_s: Sequence[float] | np.ndarray,
        camera: Camera,
        *,
        picker: PickerPath | Mapping[str, PickerPath] | None = None,
        cloth: ClothDescription | None = None,
        actions: Sequence[PickAndPlace | tuple[int, int]] | None = None,
        mask: Sequence[np.ndarray] | np.ndarray | None = None,
        table: Table | None = None,
        name: str = "recording",
    ) -> "Recording":
        """Return a recording of one camera from arrays, such as those of a sensor's driver.

        It can be used as any recording; `recordings.write_recording` writes it to a folder.

        Args:
            depth: one picture per frame, (frames, height, width) float, along the optical axis [m];
                0 where nothing was measured.
            color: one picture per frame, (frames, height, width, 3) uint8, red first; None without
                color.
            times_s: when each frame was taken [s], strictly increasing.
            camera: intrinsics, and the pose in the world.
            picker: the path of the tip in the world, by name where there are several.
            cloth: what is known of the cloth; a color, a mask or the table locates it.
            actions: first and last frame of each pick-and-place; by default from the last frame
                before a picker closes to the first one after it has opened.
            mask: pixels of the cloth, one picture per frame, (frames, height, width) bool.
            table: the plane that the cloth lies on; None when it hangs.
            name: name of the recording, and of what is tracked from it.

        Raises:
            InvalidRecordingError: arrays that do not belong together, depth in another unit, or an
                action that no picker makes.
        """
        for what, value, kind in (
            ("camera", camera, Camera),
            ("cloth", cloth or ClothDescription(), ClothDescription),
            ("table", table or Table(np.zeros(3), np.eye(3)[2]), Table),
        ):
            if not isinstance(value, kind):
                raise InvalidRecordingError(
                    f"{name}: {what} is a {type(value).__name__}; give a ct.{kind.__name__}"
                )
        times = _numbers(f"{name}: times_s", times_s, (None,))
        for kind, pictures in (("depth", depth), ("color", color), ("mask", mask)):
            if not hasattr(pictures, "__len__") and (pictures is not None or kind == "depth"):
                raise InvalidRecordingError(
                    f"{name}: {kind} is a {type(pictures).__name__}; give a list of pictures, or "
                    "one array of all"
                )
            if pictures is not None and len(pictures) != len(times):
                raise InvalidRecordingError(
                    f"{name}: {len(pictures)} pictures of {kind} for {len(times)} times; give one "
                    "of each frame"
                )
        wrong = np.flatnonzero(~(np.diff(times, prepend=-np.inf) > 0) | ~np.isfinite(times))
        if not len(times) or len(wrong):
            raise InvalidRecordingError(
                f"{name}: times_s[{wrong[0]}] is {times[wrong[0]]}, not after the frame before; "
                "give seconds in order" if len(wrong) else f"{name}: there is no frame"
            )  # fmt: skip
        frames = tuple(
            Frame.of_arrays(
                index, time, camera, depth=depth[index],
                color=None if color is None else color[index],
                mask=None if mask is None else mask[index],
            )
            for index, time in enumerate(times.tolist())
        )  # fmt: skip
        _require_meters(name, frames[0].depth[camera.name])
        given = {"picker": picker} if isinstance(picker, PickerPath) else picker or {}
        paths = {each: _checked_path(f"{name}: picker {each!r}", given[each]) for each in given}
        return cls(
            folder=Path(name),
            cameras=(camera,),
            depth_units_m={camera.name: WRITTEN_UNIT_M},
            frames=frames,
            actions=_checked_actions(name, actions, paths, times),
            picker_paths=paths,
            table=table and _checked_table(name, table),
            cloth=cloth or ClothDescription(),
        )


def _numbers(what: str, value: Any, shape: tuple[int | None, ...]) -> np.ndarray:
    """Return numbers of this shape, in which None stands for any length, or refuse them by name."""
    try:
        array = np.asarray(value, np.float64)
        is_right = len(array.shape) == len(shape) and all(
            wanted in (None, given) for wanted, given in zip(shape, array.shape, strict=True)
        )
        found = f"has shape {array.shape}"
    except (TypeError, ValueError):
        array, is_right, found = np.empty(0), False, f"is {value!r:.60}"
    if not is_right:
        wanted = " x ".join("N" if size is None else str(size) for size in shape)
        raise InvalidRecordingError(f"{what} {found}; give {wanted} numbers")
    return array


def _checked_path(what: str, path: Any) -> PickerPath:
    """Return the path with arrays that belong together."""
    if not isinstance(path, PickerPath):
        raise InvalidRecordingError(f"{what} is a {type(path).__name__}; give a ct.PickerPath")
    times = _numbers(f"{what}: time_s", path.time_s, (None,))
    positions = _numbers(f"{what}: positions", path.positions, (len(times), 3))
    closed = _numbers(f"{what}: closed", path.closed, (len(times),)) > 0
    wrong = np.flatnonzero(
        ~(np.diff(times, prepend=-np.inf) > 0) | ~np.isfinite(times + positions.sum(axis=1))
    )
    if len(wrong) or not len(times):
        told = f"sample {wrong[0]} at {times[wrong[0]]} s" if len(wrong) else "no sample"
        raise InvalidRecordingError(
            f"{what}: {told}: give finite positions [m] in order of time [s]"
        )
    return PickerPath(times, positions, closed)


def _checked_table(name: str, table: Table) -> Table:
    """Return the table with a unit normal."""
    point, normal = (
        _numbers(f"{name}: table.{part}", getattr(table, part), (3,))
        for part in ("point", "normal")
    )
    if words := not_up(normal):
        raise InvalidRecordingError(f"{name}: table.normal is {normal.tolist()}: {words}")
    return Table(point, normal / np.linalg.norm(normal))


def _require_meters(name: str, depth_m: Float32[np.ndarray, "_ _"]) -> None:
    """Refuse depth that cannot be in meters."""
    measured = depth_m[depth_m > 0]
    if not measured.size:
        raise InvalidRecordingError(f"{name}: the first depth picture is 0 everywhere")
    median = float(np.median(measured))
    if not NEAREST_MEDIAN_M <= median <= FARTHEST_MEDIAN_M:
        raise InvalidRecordingError(
            f"{name}: the median of the first depth picture is {median:.3g} m (plausible: "
            f"{NEAREST_MEDIAN_M} to {FARTHEST_MEDIAN_M} m); give meters, millimeters times 0.001"
        )


def _checked_actions(
    name: str, actions: Any, paths: Mapping[str, PickerPath], times: Float[np.ndarray, " frames"]
) -> tuple[PickAndPlace, ...]:
    """Return the given actions, or else those of the closures."""
    if actions is None:
        return tuple(actions_of(paths, times.tolist())[0])
    checked: list[PickAndPlace] = []
    for each in actions:
        try:
            one = each if isinstance(each, PickAndPlace) else PickAndPlace(*each, tuple(paths))
            one = PickAndPlace(index(one.first_frame), index(one.last_frame), one.pickers)
        except TypeError:
            raise InvalidRecordingError(
                f"{name}: an action is {each!r:.60}; give its first and last frame"
            ) from None
        start = checked[-1].last_frame if checked else 0
        if not start <= one.first_frame < one.last_frame < len(times):
            raise InvalidRecordingError(
                f"{name}: an action lasts from frame {one.first_frame} to {one.last_frame}; frames "
                f"run from {start} to {len(times) - 1}, and an action takes at least two"
            )
        for picker in one.pickers or ("picker",):
            path = paths.get(picker)
            if path is None or not path.covers(times[one.first_frame], times[one.last_frame]):
                raise InvalidRecordingError(
                    f"{name}: the path of picker {picker!r} does not cover the action from frame "
                    f"{one.first_frame} to {one.last_frame}; give all of its path, on the clock "
                    "of the frames"
                )
        checked.append(one)
    return tuple(checked)
