"""Folders of pictures as a source, in the layouts of TUM, Open3D and BOP."""

import re
from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack_capture.importing.containers import MOST_BYTES
from clothtrack_capture.importing.images import png_depth
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.intrinsics import Intrinsics
from clothtrack_capture.importing.intrinsics_file import IntrinsicsFile, read_intrinsics, read_json
from clothtrack_capture.importing.packed_pictures import packed_color, packed_depth
from clothtrack_capture.importing.source import (
    Content,
    StereoCalibration,
    StreamFrame,
    Streams,
    natural_order,
)

_DEPTH_FOLDERS = ("depth",)
_COLOR_FOLDERS = ("rgb", "color", "image", "images")
_INTRINSICS = ("intrinsic.json", "camera_intrinsic.json", "intrinsics.json", "camera.json")
_BOP = "scene_camera.json"
_PICTURES = (".png", ".jpg", ".jpeg")
_MOST_FILES = 1_000_000


def is_picture_folder(path: Path) -> bool:
    """Return whether a folder contains a folder of depth pictures."""
    return any((path / name).is_dir() for name in _DEPTH_FOLDERS)


class FolderSource:
    """A folder with depth pictures, optional color pictures, and the data needed to read them."""

    def __init__(self, path: Path, options: ImportOptions) -> None:
        """List the pictures and read intrinsics, unit and times."""
        self._path = path
        if (path / "depth.txt").is_file():
            kind = "folder in TUM style"
            depth, color, notes = self._tum()
        else:
            kind = "folder in BOP style" if (path / _BOP).is_file() else "folder in Open3D style"
            depth, color, notes = self._numbered(options)
        if options.without_color:
            color = None
        calibration = self._calibration(options, with_color=color is not None)
        if options.picker_topic or options.picker_frame or options.gripper_topic:
            notes.append("a folder has no topics: give the picker's path with --picker-csv")
        origins = {"depth": f"{len(depth)} files"}
        if color is not None:
            origins["color"] = f"{len(color)} files"
        self.streams = Streams(kind, calibration, depth, color, origins, notes)

    def depth(self, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes the counts of a depth picture."""
        return partial(packed_depth, self._bytes(frame))

    def color(self, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes red, green and blue."""
        return partial(packed_color, self._bytes(frame))

    def close(self) -> None:
        """Do nothing; no file is kept open."""

    def _bytes(self, frame: StreamFrame) -> bytes:
        path: Path = frame.place
        try:
            if not path.is_file() or path.stat().st_size > MOST_BYTES:
                raise TruncatedError(f"{path.name} is missing or too large")
            return path.read_bytes()
        except OSError as error:
            raise TruncatedError(f"{path.name}: {error.strerror}") from error

    def _tum(self) -> tuple[list[StreamFrame], list[StreamFrame] | None, list[str]]:
        notes: list[str] = []
        depth = self._listed(self._path / "depth.txt", notes)
        color = None
        if (self._path / "rgb.txt").is_file():
            color = self._listed(self._path / "rgb.txt", notes)
        return depth, color, notes

    def _listed(self, path: Path, notes: list[str]) -> list[StreamFrame]:
        """Return the frames from a list with lines `seconds file`; `#` starts a remark."""
        frames, skipped = [], 0
        root = self._path.resolve()
        try:
            with path.open(encoding="utf-8") as lines:
                for line in islice(lines, _MOST_FILES):
                    words = line.split(maxsplit=1)
                    if not words or words[0].startswith("#"):
                        continue
                    file = self._path / words[-1].strip()
                    time_ns = _nanoseconds(words[0])
                    if len(words) < 2 or time_ns is None or not _lies_in(root, file):
                        skipped += 1
                        continue
                    frames.append(StreamFrame(time_ns, file))
        except (OSError, ValueError) as error:
            raise InvalidRecordingError(f"{path}: cannot be read ({error}); correct it") from error
        if skipped:
            notes.append(f"{path.name}: {skipped} lines are not `seconds file`, left out")
        return frames

    def _numbered(
        self, options: ImportOptions
    ) -> tuple[list[StreamFrame], list[StreamFrame] | None, list[str]]:
        depth_files = _pictures(self._path, _DEPTH_FOLDERS)
        color_files = _pictures(self._path, _COLOR_FOLDERS)
        fps = options.fps or self._fps()
        if fps is None:
            raise InvalidRecordingError(f"{self._path}: {self._missing(options)}")
        # Pictures of the same name belong to the same moment, even if one of them is missing.
        stems = sorted(
            {file.stem for file in (*depth_files, *(color_files or ()))}, key=natural_order
        )
        times = {stem: round(1e9 * number / fps) for number, stem in enumerate(stems)}
        depth = [StreamFrame(times[file.stem], file) for file in depth_files]
        color = None
        if color_files is not None:
            color = [StreamFrame(times[file.stem], file) for file in color_files]
        return depth, color, [f"no time stamps: pictures taken as {fps:g} per second"]

    def _fps(self) -> float | None:
        file = self._intrinsics_file()
        return None if file is None else read_intrinsics(file).fps

    def _intrinsics_file(self) -> Path | None:
        return next(
            (self._path / name for name in _INTRINSICS if (self._path / name).is_file()), None
        )

    def _calibration(self, options: ImportOptions, *, with_color: bool) -> StereoCalibration:
        unit, origin = options.depth_unit_m, "given by --depth-unit-m"
        file = options.intrinsics or self._intrinsics_file()
        if file is not None:
            given = read_intrinsics(file)
            if unit is None and given.depth_unit_m is not None:
                unit, origin = given.depth_unit_m, f"depth_scale in {file.name}"
        elif (self._path / _BOP).is_file():
            given, scale_m = self._bop()
            if unit is None:
                unit, origin = scale_m, f"depth_scale in {_BOP}"
        else:
            raise InvalidRecordingError(f"{self._path}: {self._missing(options)}")
        if unit is None:
            raise InvalidRecordingError(f"{self._path}: {self._missing(options)}")
        return given.calibration(unit, origin, with_color=with_color)

    def _missing(self, options: ImportOptions) -> str:
        """Return everything that a folder does not specify, and how to specify it."""
        file = options.intrinsics or self._intrinsics_file()
        given = None if file is None else read_intrinsics(file)
        is_bop = given is None and (self._path / _BOP).is_file()
        wanted = []
        if not (self._path / "depth.txt").is_file() and not (
            options.fps or (given is not None and given.fps)
        ):
            wanted.append(("when the pictures were taken", "--fps"))
        if given is None and not is_bop:
            looked_for = ", ".join((*_INTRINSICS, _BOP))
            wanted.append((f"the intrinsics (looked for {looked_for})", "--intrinsics FILE"))
        known = is_bop or (given is not None and given.depth_unit_m is not None)
        if options.depth_unit_m is None and not known:
            unit = "--depth-unit-m (0.001 for millimeters, 0.0002 for the data sets of TUM)"
            wanted.append(("how long a unit of depth is", unit))
        what, options_ = zip(*wanted, strict=True)
        return f"nothing says {' or '.join(what)}; give {' and '.join(options_)}"

    def _bop(self) -> tuple[IntrinsicsFile, float]:
        """Return the intrinsics and unit [m] of `scene_camera.json`, the same for every picture."""
        path = self._path / _BOP
        content = read_json(path)
        entries = list(content.values()) if isinstance(content, dict) else []
        numbers = [_bop_entry(path, entry) for entry in entries]
        if not numbers:
            raise InvalidRecordingError(f"{path}: no picture is described; see docs/import.md")
        if max(max(abs(a - b) for a, b in zip(row, numbers[0], strict=True)) for row in numbers) > (
            1e-6
        ):
            raise InvalidRecordingError(
                f"{path}: cam_K or depth_scale changes from picture to picture; a recording has "
                "one fixed camera: split the scene"
            )
        fx, fy, cx, cy, scale = numbers[0]
        width, height = self._first_size()
        intrinsics = Intrinsics(width, height, fx, fy, cx, cy)
        if not (fx > 0 and fy > 0 and 0 < scale < 1e6):
            raise InvalidRecordingError(f"{path}: cam_K or depth_scale is not positive; correct it")
        return IntrinsicsFile(intrinsics, intrinsics, np.eye(4)), scale * 1e-3

    def _first_size(self) -> tuple[int, int]:
        for file in _pictures(self._path, _DEPTH_FOLDERS):
            try:
                height, width = png_depth(self._bytes(StreamFrame(0, file))).shape
            except TruncatedError:
                continue
            return width, height
        raise InvalidRecordingError(f"{self._path}: no 16-bit PNG of depth can be read")


def _bop_entry(path: Path, entry: Any) -> tuple[float, float, float, float, float]:
    try:
        k, scale = [float(value) for value in entry["cam_K"]], float(entry["depth_scale"])
        return k[0], k[4], k[2], k[5], scale
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise InvalidRecordingError(
            f"{path}: an entry has no cam_K of nine numbers or no depth_scale; correct it"
        ) from error


def _pictures(path: Path, folders: Sequence[str]) -> Any:
    """Return the pictures of the first existing folder, in natural order; None if there is none."""
    for name in folders:
        if (path / name).is_dir():
            files = [
                file for file in islice((path / name).iterdir(), _MOST_FILES)
                if file.suffix.lower() in _PICTURES and _lies_in(path.resolve(), file)
            ]  # fmt: skip
            return sorted(files, key=lambda file: natural_order(file.stem))
    return None


def _lies_in(folder: Path, file: Path) -> bool:
    try:
        return file.resolve().is_relative_to(folder)
    except (OSError, ValueError, RuntimeError):
        return False


def _nanoseconds(word: str) -> int | None:
    """Return a decimal number of seconds as exact nanoseconds."""
    match = re.fullmatch(r"(\d{1,10})(?:\.(\d{0,12}))?", word)
    if match is None:
        return None
    return int(match[1]) * 10**9 + int((match[2] or "").ljust(9, "0")[:9])
