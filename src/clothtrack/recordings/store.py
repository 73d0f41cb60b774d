"""Recordings on disk: read one, or write one frame by frame while it is recorded."""

import io
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.errors import InvalidRecordingError, StorageError
from clothtrack.files.atomic_write import clear_leftovers, hidden_name, remove_folder, storage
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.frame_files import PictureKind, conventional_name
from clothtrack.recordings.picker_table import PICKER_FILE, picker_text
from clothtrack.recordings.pictures import (
    encode_png,
    parse_header,
    read_cloud,
    read_color,
    read_depth,
    read_mask,
)
from clothtrack.recordings.recording import (
    ClothDescription,
    Frame,
    ObservedRegion,
    PickerPath,
    Recording,
    Table,
)
from clothtrack.recordings.recording_file import VERSION
from clothtrack.recordings.template_file import canonical_text, obj_text
from clothtrack.recordings.validation import check_recording
from clothtrack.recordings.violation import DOCUMENT

_TEMPLATE_FILE = "template.obj"
_CANONICAL_FILE = "template_canonical.csv"


def read_recording(folder: Path | str) -> Recording:
    """Read the recording in a folder; pictures stay on disk.

    Raises:
        InvalidRecordingError: with the first violation and how many there are
            (`clothtrack.recordings.inspection.inspect` gives all).
    """
    folder = Path(folder)
    checked = check_recording(folder)
    if checked.recording is None:
        first, *more = checked.violations
        rest = f" (and {len(more)} more: clothtrack inspect {folder})" if more else ""
        raise InvalidRecordingError(f"{folder}: {first.message}{rest}")
    return checked.recording


def write_recording(recording: Recording, folder: Path) -> Recording:
    """Write a recording to another folder, pictures included, and read it back."""
    with RecordingWriter(
        folder,
        recording.cameras,
        recording.depth_units_m,
        table=recording.table,
        cloth=recording.cloth,
        observed=recording.observed,
        provenance=recording.provenance,
    ) as writer:
        for frame in recording.frames:
            writer.copy_frame(frame, frame.time_s)
        for action in recording.actions:
            writer.add_action(action.first_frame, action.last_frame, action.pickers)
        for name, path in recording.picker_paths.items():
            writer.set_picker_path(name, path)
    return read_recording(folder)


class RecordingWriter:
    """A writer of a recording, frame by frame: all of it appears under its name, or nothing.

    Use it in a `with` block. Files are written to a hidden folder beside the target. If the block
    succeeds, they are checked and the folder is renamed; if it raises, they are removed. A killed
    process leaves only the hidden folder; the next writer beside it removes that.
    """

    def __init__(
        self,
        folder: Path | str,
        cameras: Sequence[Camera],
        depth_units_m: Mapping[str, float],
        *,
        table: Table | None = None,
        cloth: ClothDescription | None = None,
        observed: ObservedRegion | None = None,
        provenance: Mapping[str, object] | None = None,
    ) -> None:
        """Make the hidden folder.

        Args:
            folder: folder of the recording; must not exist.
            cameras: every camera.
            depth_units_m: meters per unit of the depth files, per camera name.
            table: the table, or None when the cloth hangs.
            cloth: what is known of the cloth, with its template.
            observed: where data was cut away.
            provenance: who made it and how; anything that JSON can hold.

        Raises:
            StorageError: the folder exists or cannot be made.
        """
        self._folder = Path(folder).absolute()
        self._cameras = {camera.name: camera for camera in cameras}
        self._units = dict(depth_units_m)
        self._table = table
        self._cloth = cloth or ClothDescription()
        self._observed = observed or ObservedRegion()
        self._provenance = dict(provenance or {})
        self._frames: list[dict[str, Any]] = []
        self._actions: list[dict[str, Any]] = []
        self._paths: dict[str, PickerPath] = {}
        if self._folder.exists():
            raise StorageError(f"{folder} exists; delete it or write to another name")
        clear_leftovers([self._folder])
        self._partial = self._folder.with_name(hidden_name(self._folder.name))
        with storage(self._partial):
            self._partial.mkdir(parents=True)

    def __enter__(self) -> "RecordingWriter":
        """Return the writer itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the recording, or remove what was written when the block raised.

        Raises:
            InvalidRecordingError: what was written is no valid recording.
            StorageError: the disk refuses.
        """
        try:
            if kind is None:
                self._finish()
        finally:
            remove_folder(self._partial)

    def add_frame(
        self,
        time_s: float,
        *,
        color: Mapping[str, UInt8[np.ndarray, "_ _ 3"]] | None = None,
        depth: Mapping[str, Float[np.ndarray, "_ _"]] | None = None,
        mask: Mapping[str, Bool[np.ndarray, "_ _"]] | None = None,
        cloud: Float[np.ndarray, "points 3"] | None = None,
    ) -> None:
        """Write one frame.

        Args:
            time_s: time since the start [s], after the frame before.
            color: per camera name, 8-bit picture, red first.
            depth: per camera name, depth [m]; what is not finite, not positive or beyond 65,535
                units is written as 0, no measurement.
            mask: per camera name, mask of the cloth.
            cloud: points of the cloth in the world [m].

        Raises:
            InvalidRecordingError: a camera is unknown, a picture has another size, the time does
                not advance.
            StorageError: the disk refuses.
        """
        index = len(self._frames)
        shown_by: dict[PictureKind, Mapping[str, np.ndarray]] = {
            "color": color or {},
            "depth": depth or {},
            "mask": mask or {},
        }
        encoded: dict[PictureKind, dict[str, bytes]] = {}
        for kind, shown in shown_by.items():
            for name, picture in shown.items():
                self._check_size(index, name, picture.shape[1::-1])
                png = encode_png(self._stored(kind, name, picture))
                encoded.setdefault(kind, {})[name] = png
        self._add(time_s, encoded, cloud)

    def copy_frame(self, frame: Frame, time_s: float) -> None:
        """Write a frame of another recording of the same cameras, at another time [s].

        Raises:
            InvalidRecordingError: a picture cannot be read, or as for `add_frame`.
            StorageError: the disk refuses.
        """
        self.add_frame(
            time_s,
            color={name: read_color(path) for name, path in frame.color.items()},
            depth={name: read_depth(path, self._units[name]) for name, path in frame.depth.items()},
            mask={name: read_mask(path) for name, path in frame.mask.items()},
            cloud=None if frame.cloud is None else read_cloud(frame.cloud),
        )

    def add_encoded_frame(
        self, time_s: float, encoded: Mapping[PictureKind, Mapping[str, bytes]]
    ) -> None:
        """Write one frame whose pictures are PNG files already, as `encode_png` makes them.

        Use it for many frames: encoding takes most of the time, and several threads may do it.

        Args:
            time_s: time since the start [s], after the frame before.
            encoded: PNG per kind ("color" 8-bit, "depth" 16-bit gray in the camera's
                `depth_units_m`, "mask" 8-bit gray) and camera name.

        Raises:
            InvalidRecordingError: a camera is unknown, a picture has another size, the time does
                not advance.
            StorageError: the disk refuses.
        """
        for shown in encoded.values():
            for name, png in shown.items():
                header = parse_header(Path(name), png[:29], png[-12:])
                self._check_size(len(self._frames), name, (header.width, header.height))
        self._add(time_s, encoded, None)

    def _add(
        self,
        time_s: float,
        encoded: Mapping[PictureKind, Mapping[str, bytes]],
        cloud: Float[np.ndarray, "points 3"] | None,
    ) -> None:
        index = len(self._frames)
        if self._frames and not time_s > self._frames[-1]["time_s"]:
            raise InvalidRecordingError(
                f"frame {index}: time_s is {time_s}, not after {self._frames[-1]['time_s']}; "
                "write frames in order of time"
            )
        if not math.isfinite(time_s):
            raise InvalidRecordingError(f"frame {index}: time_s is {time_s}; write seconds")
        entry: dict[str, Any] = {"index": index, "time_s": float(time_s)}
        single = len(self._cameras) == 1
        for kind, shown in encoded.items():
            names: dict[str, str] = {}
            for name, png in shown.items():
                names[name] = conventional_name(kind, index, None if single else name)
                self._write(names[name], png)
            if names:
                entry[kind] = next(iter(names.values())) if single else names
        if cloud is not None:
            entry["cloud"] = conventional_name("cloud", index)
            buffer = io.BytesIO()
            np.savez_compressed(buffer, points=cloud)
            self._write(entry["cloud"], buffer.getvalue())
        self._frames.append(entry)

    def add_action(self, first_frame: int, last_frame: int, pickers: Sequence[str]) -> None:
        """Add a pick-and-place, which includes `last_frame`."""
        self._actions.append(
            {"first_frame": first_frame, "last_frame": last_frame, "pickers": list(pickers)}
        )

    def set_picker_path(self, name: str, path: PickerPath) -> None:
        """Set the path of a picker's tip during the whole recording."""
        if not name or not re.fullmatch(r"[^\s,\"]+", name):
            raise InvalidRecordingError(
                f"picker {name!r}: a picker's name has no spaces, commas or quotes; rename it"
            )
        self._paths[name] = path

    def _check_size(self, index: int, name: str, size: tuple[int, ...]) -> None:
        camera = self._cameras.get(name)
        if camera is None:
            raise InvalidRecordingError(
                f"frame {index}: there is no camera {name!r}; cameras: {', '.join(self._cameras)}"
            )
        if size != (camera.width, camera.height):
            raise InvalidRecordingError(
                f"frame {index}: a picture of {size[0]} x {size[1]} pixels from camera {name!r} of "
                f"{camera.width} x {camera.height}; resize the picture or correct the camera"
            )

    def _stored(self, kind: PictureKind, name: str, picture: np.ndarray) -> np.ndarray:
        if kind == "mask":
            return picture.astype(np.uint8) * 255
        if kind == "color":
            return picture
        if name not in self._units:
            raise InvalidRecordingError(f"camera {name!r} has depth; give depth_units_m for it")
        units = np.rint(np.nan_to_num(picture, nan=0.0, posinf=0.0) / self._units[name])
        return np.where((units > 0) & (units <= 65535), units, 0).astype(np.uint16)

    def _write(self, file: str, data: bytes) -> None:
        path = self._partial / file
        with storage(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)

    def _finish(self) -> None:
        template = self._cloth.template
        if template is not None:
            self._write(_TEMPLATE_FILE, obj_text(template).encode())
            if template.canonical is not None:
                self._write(_CANONICAL_FILE, canonical_text(template.canonical).encode())
        if self._paths:
            self._write(PICKER_FILE, picker_text(self._paths).encode())
        text = json.dumps(self._document(), indent=1, ensure_ascii=False, allow_nan=False)
        self._write(DOCUMENT, text.encode())
        checked = check_recording(self._partial)
        if checked.recording is None:
            first = checked.violations[0]
            raise InvalidRecordingError(f"{self._folder}: {first.message}", first)
        with storage(self._folder):
            self._partial.rename(self._folder)

    def _document(self) -> dict[str, Any]:
        document: dict[str, Any] = {
            "version": VERSION,
            "cameras": [self._camera_entry(camera) for camera in self._cameras.values()],
            "frames": self._frames,
            "actions": self._actions,
            "cloth": _cloth_entry(self._cloth),
            "observed": {
                "lowest_height_m": self._observed.lowest_height_m,
                "tool_clearance_m": self._observed.tool_clearance_m,
            },
            "provenance": self._provenance,
        }
        if self._table is not None:
            document["table"] = {
                "point": self._table.point.tolist(),
                "normal": self._table.normal.tolist(),
            }
        return document

    def _camera_entry(self, camera: Camera) -> dict[str, Any]:
        entry: dict[str, Any] = {
            name: getattr(camera, name)
            for name in ("name", "width", "height", "fx", "fy", "cx", "cy")
        }
        entry["world_from_camera"] = camera.world_from_camera.tolist()
        if camera.name in self._units:
            entry["depth_unit_m"] = self._units[camera.name]
        return entry


def _cloth_entry(cloth: ClothDescription) -> dict[str, Any]:
    entry: dict[str, Any] = {"kind": cloth.kind}
    if cloth.color is not None:
        entry["color"] = cloth.color
    if cloth.size_m is not None:
        entry["size_m"] = list(cloth.size_m)
    if cloth.grasp_uncertainty_m:
        entry["grasp_uncertainty_m"] = cloth.grasp_uncertainty_m
    if cloth.template is not None:
        entry["template"] = _TEMPLATE_FILE
        if cloth.template.canonical is not None:
            entry["template_canonical"] = _CANONICAL_FILE
    if cloth.held_vertices:
        entry["held_vertices"] = {
            name: np.asarray(held).tolist() for name, held in cloth.held_vertices.items()
        }
    return entry
