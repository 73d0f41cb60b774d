"""Folders of pictures as a source, in the layouts of TUM, Open3D and BOP, and those like them."""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack_capture.importing.images import png_depth
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.intrinsics import Intrinsics
from clothtrack_capture.importing.intrinsics_file import (
    IntrinsicsFile,
    read_intrinsics,
    read_json,
    text_of,
)
from clothtrack_capture.importing.packed_pictures import packed_color, packed_depth, packed_mask
from clothtrack_capture.importing.source import (
    Content,
    StreamFrame,
    Streams,
    listed,
    natural_order,
)
from clothtrack_capture.importing.units import DepthUnit

_FOLDERS = {
    "depth": ("depth",),
    "color": ("rgb", "color", "image", "images"),
    "mask": ("mask", "masks"),
}
_PACKED = {"depth": packed_depth, "color": packed_color, "mask": packed_mask}
_INTRINSICS = ("intrinsic.json", "camera_intrinsic.json", "intrinsics.json", "camera.json")
_BOP = "scene_camera.json"
_ASSOCIATIONS = ("associations.txt", "association.txt", "associate.txt", "associated.txt")
_PICTURES = (".png", ".jpg", ".jpeg")
_MOST_FILES, _MOST_BYTES = 1_000_000, 96 * 2**20
_IGNORED = re.compile(r"^\.|readme|license|^thumbs\.db$", re.IGNORECASE)
_SAME_MOVE_M = 1e-3


def is_picture_folder(path: Path) -> bool:
    """Return whether a folder contains a folder of depth pictures."""
    return any((path / name).is_dir() for name in _FOLDERS["depth"])


class FolderSource:
    """A folder with depth pictures, optional color and masks, and the data needed to read them."""

    def __init__(self, path: Path, options: ImportOptions) -> None:
        """List the pictures and read intrinsics, unit and times."""
        self._path, self._options, self._notes = path, options, list[str]()
        self._used: set[str] = set()
        self._lens_file = options.intrinsics or self._there(_INTRINSICS)
        self._lens = None if self._lens_file is None else read_intrinsics(self._lens_file)
        files = {kind: self._pictures(kind) for kind in _FOLDERS}
        associations, lists = self._there(_ASSOCIATIONS), (path / "depth.txt").is_file()
        if associations is not None:
            kind = f"folder with {associations.name}"
            streams = self._associated(associations)
        elif lists:
            kind, streams = "folder in TUM style", self._tum(files)
        else:
            kind = "folder in BOP style" if (path / _BOP).is_file() else "folder in Open3D style"
            streams = self._numbered(files)
        self._there((_BOP,))
        lens = self._lens or (self._bop() if (path / _BOP).is_file() else None)
        if lens is None:
            raise InvalidRecordingError(f"{path}: {self._missing()}")
        unit = lens.unit
        if options.depth_unit_m is not None:
            unit = DepthUnit(options.depth_unit_m, "given by --depth-unit-m")
        if options.picker_topic or options.picker_frame or options.gripper_topic:
            self._notes.append("a folder has no topics: give the picker's path with --picker-csv")
        if options.without_color:
            streams["color"] = None
        color = streams["color"]
        rest = sorted(
            file.name + "/" * file.is_dir() for file in islice(path.iterdir(), _MOST_FILES)
            if file.name not in self._used and not _IGNORED.search(file.name)
        )  # fmt: skip
        if rest:
            self._notes.append(f"not used: {listed(rest)}")
        mask = self._masks(files["mask"] or [], streams)
        counts = {"depth": streams["depth"], "color": color, "mask": mask or None}
        self.streams = Streams(
            kind=kind,
            calibration=lens.calibration(with_color=color is not None),
            unit=unit,
            ask_unit=self._missing(),
            depth=streams["depth"] or [],
            color=color,
            mask=mask,
            origins={
                name: f"{len(frames)} files"
                for name, frames in counts.items()
                if frames is not None
            },
            notes=[*self._notes, *lens.notes],
        )

    def picture(self, kind: str, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes a picture."""
        return partial(_PACKED[kind], self._bytes(frame))

    def close(self) -> None:
        """Do nothing; no file is kept open."""

    def _bytes(self, frame: StreamFrame) -> bytes:
        path: Path = frame.place
        try:
            if not path.is_file() or path.stat().st_size > _MOST_BYTES:
                raise TruncatedError(f"{path.name} is missing or too large")
            return path.read_bytes()
        except OSError as error:
            raise TruncatedError(f"{path.name}: {error.strerror}") from error

    def _there(self, names: Sequence[str]) -> Path | None:
        """Return the first file of these names that is there, and note that they are used."""
        self._used.update(names)
        return next((self._path / name for name in names if (self._path / name).is_file()), None)

    def _pictures(self, kind: str) -> list[Path] | None:
        """Return the pictures of the first existing folder, in natural order; None without one."""
        root = self._path.resolve()
        for name in _FOLDERS[kind]:
            if not (self._path / name).is_dir():
                continue
            self._used.add(name)
            every = [file for file in islice((self._path / name).iterdir(), _MOST_FILES)
                     if not _IGNORED.search(file.name)]  # fmt: skip
            files = [file for file in every
                     if file.suffix.lower() in _PICTURES and _lies_in(root, file)]  # fmt: skip
            if others := sorted(file.name for file in set(every) - set(files)):
                self._notes.append(
                    f"{len(others)} files in {name}/ that are no PNG or JPEG in this folder: "
                    f"{listed(others, 3)}"
                )
            return sorted(files, key=lambda file: natural_order(file.stem))
        return None

    def _tum(self, files: Mapping[str, list[Path] | None]) -> dict[str, list[StreamFrame] | None]:
        depth = self._listed("depth.txt")
        names = ("rgb.txt", "color.txt")
        self._used.update(names)
        name = next((name for name in names if (self._path / name).is_file()), None)
        if name is not None:
            return {"depth": depth, "color": self._listed(name)}
        if files["color"]:
            stems = {frame.place.stem: frame.time_ns for frame in depth}
            times = self._times_by_name(files["color"], stems, len(depth), "color")
            return {"depth": depth, "color": times or None}
        return {"depth": depth, "color": None}

    def _lines(self, name: str) -> list[list[str]]:
        """Return the words of each line of a list; `#` starts a remark."""
        self._used.add(name)
        try:
            text = text_of((self._path / name).read_bytes())
        except OSError as error:
            raise InvalidRecordingError(
                f"{self._path / name}: cannot be read ({error}); correct it"
            ) from error
        lines = islice(text.splitlines(), _MOST_FILES)
        return [line.split() for line in lines if line.strip() and not line.startswith("#")]

    def _listed(self, name: str) -> list[StreamFrame]:
        """Return the frames from a list with lines `seconds file`."""
        frames, skipped, root = [], [], self._path.resolve()
        for words in self._lines(name):
            time_ns, file = _nanoseconds(words[0]), self._path / " ".join(words[1:])
            if len(words) < 2 or time_ns is None or not _lies_in(root, file):
                skipped.append(" ".join(words))
                continue
            frames.append(StreamFrame(time_ns, file))
        if skipped:
            self._notes.append(
                f"{name}: {len(skipped)} lines are not `seconds file`, left out: "
                f"{listed(skipped, 2)[:80]}"
            )
        return frames

    def _associated(self, path: Path) -> dict[str, list[StreamFrame] | None]:
        """Return the pairs from lines `seconds file seconds file`, at the times of depth."""
        depth, color, skipped, root = [], [], [], self._path.resolve()
        for words in self._lines(path.name):
            times = [_nanoseconds(word) for word in words[::2]]
            files = [self._path / word for word in words[1::2]]
            is_depth = [file.parent.name in _FOLDERS["depth"] for file in files]
            if len(words) != 4 or None in times or sum(is_depth) != 1 or not all(
                _lies_in(root, file) for file in files
            ):  # fmt: skip
                skipped.append(" ".join(words))
                continue
            place = is_depth.index(True)
            time_ns = times[place] or 0
            depth.append(StreamFrame(time_ns, files[place]))
            color.append(StreamFrame(time_ns, files[1 - place]))
        self._used.update(("depth.txt", "rgb.txt"))
        self._notes.append(f"pairs as listed in {path.name}")
        if skipped:
            self._notes.append(
                f"{path.name}: {len(skipped)} lines are not `seconds file seconds file` with one "
                f"file in depth/, left out: {listed(skipped, 2)[:80]}"
            )
        return {"depth": depth, "color": color}

    def _numbered(
        self, files: Mapping[str, list[Path] | None]
    ) -> dict[str, list[StreamFrame] | None]:
        """Return the frames of pictures whose names tell their order, or their times."""
        fps = self._options.fps
        pictures = {name: list(files[name] or ()) for name in ("depth", "color") if files[name]}
        keys = {name: _keys(each) for name, each in pictures.items()}
        times = {name: [_name_time_ns(file.stem) for file in each]
                 for name, each in pictures.items()}  # fmt: skip
        told: dict[str, list[StreamFrame] | None] = {"depth": [], "color": None}
        if fps is None and times and all(None not in each for each in times.values()):
            self._notes.append("the names of the pictures are their times")
            return told | {
                name: [StreamFrame(time or 0, file)
                       for time, file in zip(times[name], each, strict=True)]
                for name, each in pictures.items()
            }  # fmt: skip
        fps = fps or (None if self._lens is None else self._lens.fps)
        if fps is None:
            raise InvalidRecordingError(f"{self._path}: {self._missing()}")
        if {"depth", "color"} <= keys.keys():
            keys = self._matched(keys, pictures)
        # Pictures of the same key belong to the same moment, even if one of them is missing.
        every = sorted({key for each in keys.values() for key in each}, key=natural_order)
        moment = {key: round(1e9 * number / fps) for number, key in enumerate(every)}
        self._notes.append(f"no time stamps: pictures taken as {fps:g} per second")
        return told | {
            name: [StreamFrame(moment[key], file)
                   for key, file in zip(keys[name], each, strict=True)]
            for name, each in pictures.items()
        }  # fmt: skip

    def _matched(
        self, keys: dict[str, list[str]], pictures: Mapping[str, list[Path]]
    ) -> dict[str, list[str]]:
        """Return keys by which depth and color belong together, by name or else by position."""
        depth, color = keys["depth"], keys["color"]
        both = listed([pictures[name][0].name for name in keys])
        if set(depth) == set(color):
            if {file.stem for file in pictures["depth"]} != {
                file.stem for file in pictures["color"]
            }:
                self._notes.append(f"the names of depth and color differ ({both}): the pictures "
                                   "were paired by their numbers")  # fmt: skip
            return keys
        if len(depth) == len(color) and (not {*depth} & {*color} or _is_shifted(depth, color)):
            self._notes.append(
                f"the names of depth and color differ ({both}): the {len(depth)} pictures of each "
                "were paired by position"
            )
            return {"depth": depth, "color": depth}
        if not {*depth} & {*color}:
            raise InvalidRecordingError(
                f"{self._path}: {len(depth)} depth and {len(color)} color pictures have different "
                f"names ({both}), so nothing tells which belong together; name those of one moment "
                "alike, or list the pairs in associations.txt (seconds file seconds file)"
            )
        return keys

    def _masks(
        self, files: list[Path], streams: Mapping[str, list[StreamFrame] | None]
    ) -> list[StreamFrame]:
        if not files:
            return []
        frames = streams["depth"] or []
        stems = dict(zip(_keys([frame.place for frame in frames]),
                         [frame.time_ns for frame in frames], strict=True))  # fmt: skip
        stems |= {frame.place.stem: frame.time_ns
                  for kind in ("color", "depth") for frame in streams[kind] or ()}  # fmt: skip
        return self._times_by_name(files, stems, len(frames), "mask")

    def _times_by_name(
        self, files: list[Path], times: Mapping[str, int], count: int, kind: str
    ) -> list[StreamFrame]:
        """Return the pictures at the times of those of the same name, or else by position."""
        for keys in ([file.stem for file in files], _keys(files)):
            found = [StreamFrame(times[key], file) for key, file in zip(keys, files, strict=True)
                     if key in times]  # fmt: skip
            if found:
                if len(found) < len(files):
                    self._notes.append(
                        f"{len(files) - len(found)} pictures of {kind} with the name of no frame "
                        "were left out"
                    )
                return found
        ordered = sorted(set(times.values()))
        if len(files) == count == len(ordered):
            self._notes.append(f"the {count} pictures of {kind} were matched by position")
            return [StreamFrame(time, file) for time, file in zip(ordered, files, strict=True)]
        self._notes.append(
            f"{len(files)} pictures of {kind} ({files[0].name}) for {count} of depth, with other "
            "names: left out; name those of one moment alike"
        )
        return []

    def _missing(self) -> str:
        """Return everything that a folder does not specify, and how to specify it."""
        options, lens = self._options, self._lens
        is_bop = lens is None and (self._path / _BOP).is_file()
        lists = any((self._path / name).is_file() for name in ("depth.txt", *_ASSOCIATIONS))
        wanted = []
        if not lists and not (options.fps or (lens is not None and lens.fps)):
            wanted.append(("when the pictures were taken", "--fps"))
        if lens is None and not is_bop:
            looked_for = ", ".join((*_INTRINSICS, _BOP))
            wanted.append((f"the intrinsics (looked for {looked_for})",
                           "--intrinsics FILE (JSON: width, height, fx, fy, cx, cy)"))  # fmt: skip
        known = is_bop or (lens is not None and lens.unit is not None)
        if options.depth_unit_m is None and not known:
            unit = "--depth-unit-m (0.001 for millimeters, 0.0002 for the data sets of TUM)"
            wanted.append(("how long a unit of depth is", unit))
        what, given = zip(*wanted, strict=True) if wanted else ((), ())
        return f"nothing says {' or '.join(what)}; give {' and '.join(given)}"

    def _bop(self) -> IntrinsicsFile:
        """Return the intrinsics and the unit of `scene_camera.json`, the same for every picture."""
        path = self._path / _BOP
        content = read_json(path)
        entries = list(content.values()) if isinstance(content, dict) else []
        numbers = [_bop_entry(path, entry) for entry in entries]
        if not numbers:
            raise InvalidRecordingError(f"{path}: no picture is described; see docs/import.md")
        first = numbers[0]
        if any(max(abs(a - b) for a, b in zip(row[:5], first, strict=False)) > 1e-6
               for row in numbers):  # fmt: skip
            raise InvalidRecordingError(
                f"{path}: cam_K or depth_scale changes from picture to picture; a recording has "
                "one fixed camera: split the scene"
            )
        moved_m = max(float(np.abs(np.subtract(row[5:], first[5:])).max()) for row in numbers)
        if moved_m > _SAME_MOVE_M:
            raise InvalidRecordingError(
                f"{path}: cam_t_w2c changes by {moved_m:.3f} m, so the camera moved; a recording "
                "has one fixed camera: split the scene"
            )
        fx, fy, cx, cy, scale = first[:5]
        width, height = self._first_size()
        intrinsics = Intrinsics(width, height, fx, fy, cx, cy)
        if not (fx > 0 and fy > 0 and 0 < scale < 1e6):
            raise InvalidRecordingError(f"{path}: cam_K or depth_scale is not positive; correct it")
        unit = DepthUnit(scale * 1e-3, f"depth_scale {scale:g} in {_BOP}")
        return IntrinsicsFile(path, intrinsics, intrinsics, np.eye(4), None, unit)

    def _first_size(self) -> tuple[int, int]:
        for file in self._pictures("depth") or ():
            try:
                height, width = png_depth(self._bytes(StreamFrame(0, file))).shape
            except TruncatedError:
                continue
            return width, height
        raise InvalidRecordingError(f"{self._path}: no 16-bit PNG of depth can be read")


def _bop_entry(path: Path, entry: Any) -> list[float]:
    """Return fx, fy, cx, cy, the scale, and the camera's place [m]."""
    try:
        k, scale = [float(value) for value in entry["cam_K"]], float(entry["depth_scale"])
        place = [float(value) * 1e-3 for value in entry.get("cam_t_w2c", (0.0, 0.0, 0.0))]
        return [k[0], k[4], k[2], k[5], scale, *place[:3]]
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise InvalidRecordingError(
            f"{path}: an entry has no cam_K of nine numbers or no depth_scale; correct it"
        ) from error


def _keys(files: Sequence[Path]) -> list[str]:
    """Return the part of each name that tells pictures of one folder apart, without leading zeros.

    What comes before the first and after the last digit goes where all names share it.
    """
    stems = [file.stem for file in files]
    parts = [re.fullmatch(r"(\D*)(.*?)(\D*)", stem, re.DOTALL) for stem in stems]
    ends = {(part[1], part[3]) for part in parts if part is not None}
    if len(ends) != 1:
        return stems
    middles = [part[2] for part in parts if part is not None]
    if not all(middles):
        return stems
    short = [middle.lstrip("0") or "0" if middle.isdigit() else middle for middle in middles]
    return short if len(set(short)) == len(short) else middles


def _is_shifted(depth: Sequence[str], color: Sequence[str]) -> bool:
    """Return whether both are numbered without a gap, from different first numbers."""
    if not all(key.isdigit() and len(key) < 10 for key in (*depth, *color)):
        return False
    mine, yours = sorted(map(int, depth)), sorted(map(int, color))
    return mine[-1] - mine[0] == yours[-1] - yours[0] == len(mine) - 1


def _name_time_ns(stem: str) -> int | None:
    """Return the time in a name: seconds with decimals, or a count since 1970 that looks like one.

    Counts of 13, 16 and 19 digits are milliseconds, microseconds and nanoseconds.
    """
    if match := re.fullmatch(r"(?:\D*[_-])?(\d{1,10}\.\d{2,12})", stem):
        return _nanoseconds(match[1])
    if match := re.fullmatch(r"(?:\D*[_-])?(\d{9,10})[_-](\d{9})", stem):
        return int(match[1]) * 10**9 + int(match[2])
    if match := re.fullmatch(r"(?:\D*[_-])?([1-4]\d{12}|[1-4]\d{15}|[1-4]\d{18})", stem):
        return int(match[1]) * 10 ** (19 - len(match[1]))
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
