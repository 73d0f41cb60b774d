"""Folders of pictures as a source, in the layouts of TUM, Open3D and BOP, and those like them."""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack_capture.importing.images import packed_color, packed_depth, packed_mask, png_depth
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.intrinsics import (
    Intrinsics,
    IntrinsicsFile,
    read_intrinsics,
    read_json,
    text_of,
)  # fmt: skip
from clothtrack_capture.importing.source import (
    TOPIC_OPTIONS,
    Content,
    StreamFrame,
    Streams,
    listed,
    natural_order,
    unused,
)  # fmt: skip
from clothtrack_capture.importing.units import DepthUnit

_FOLDERS = {
    "depth": ("depth",), "color": ("rgb", "color", "image", "images"), "mask": ("mask", "masks")
}  # fmt: skip
_PACKED = {"depth": packed_depth, "color": packed_color, "mask": packed_mask}
_INTRINSICS = ("intrinsic.json", "camera_intrinsic.json", "intrinsics.json", "camera.json")
_BOP = "scene_camera.json"
_ASSOCIATIONS = ("associations.txt", "association.txt", "associate.txt", "associated.txt")
_COLOR_LISTS = ("rgb.txt", "color.txt")
_PICTURES = (".png", ".jpg", ".jpeg")
_MOST_FILES, _MOST_BYTES = 1_000_000, 96 * 2**20
_IGNORED = re.compile(r"^\.|readme|license|^thumbs\.db$", re.IGNORECASE)
_MOST_MOVED_M = 1e-3


def is_picture_folder(path: Path) -> bool:
    """Return whether a folder contains a folder of depth pictures."""
    return any((path / name).is_dir() for name in _FOLDERS["depth"])


class FolderSource:
    """A folder with depth pictures, optional color and masks, and the data needed to read them."""

    def __init__(self, path: Path, options: ImportOptions) -> None:
        """List the pictures and read intrinsics, unit and times."""
        self._path, self._options, self._notes = path, options, list[str]()
        self._used, self._is_bop = {_BOP}, (path / _BOP).is_file()
        there = self._there(_INTRINSICS)
        lens_file = options.intrinsics or there
        self._lens = None if lens_file is None else read_intrinsics(lens_file)
        files = {kind: self._pictures(kind) for kind in _FOLDERS}
        lists = [self._there(names) for names in (_ASSOCIATIONS, ("depth.txt",), _COLOR_LISTS)]
        if lists[0] is not None:
            kind, streams = f"folder with {lists[0].name}", self._associated(lists[0])
        elif lists[1] is not None:
            kind, streams = "folder in TUM style", self._tum(lists[1], lists[2], files["color"])
        else:
            kind = f"folder in {'BOP' if self._is_bop else 'Open3D'} style"
            streams = self._numbered(files)
        lens = self._lens or (self._bop() if self._is_bop else None)
        ask = self._missing(files=bool(lists[0] or lists[1]))
        if lens is None:
            raise InvalidRecordingError(f"{path}: {ask}")
        given_m = options.depth_unit_m
        unit = lens.unit if given_m is None else DepthUnit(given_m, "given by --depth-unit-m")
        self._notes += unused(options, "has no topics; --picker-csv gives a path", *TOPIC_OPTIONS)
        if lists[0] or lists[1]:
            self._notes += unused(options, "has the times of a list", "fps")
        if options.without_color:
            streams.pop("color", None)
        if files["mask"]:
            streams["mask"] = self._like(files["mask"], streams, "mask")
        every = (file.name + "/" * file.is_dir() for file in islice(path.iterdir(), _MOST_FILES))
        if rest := sorted(name for name in every if name.rstrip("/") not in self._used
                          and not _IGNORED.search(name)):  # fmt: skip
            self._notes.append(f"not used: {listed(rest)}")
        self.streams = Streams(
            kind=kind,
            calibration=lens.calibration(with_color="color" in streams),
            unit=unit,
            ask_unit=ask,
            depth=streams["depth"],
            color=streams.get("color"),
            mask=streams.get("mask", []),
            origins={name: f"{len(frames)} files" for name, frames in streams.items()},
            notes=[*self._notes, *lens.notes],
        )

    def picture(self, kind: str, frame: StreamFrame) -> Callable[[], Content]:
        """Return a function that decodes a picture."""
        return partial(_PACKED[kind], self._bytes(frame.place))

    def close(self) -> None:
        """Do nothing; no file is kept open."""

    def _bytes(self, path: Path) -> bytes:
        try:
            if not path.is_file() or path.stat().st_size > _MOST_BYTES:
                raise TruncatedError(f"{path.name} is missing or too large")
            return path.read_bytes()
        except OSError as error:
            raise TruncatedError(f"{path.name}: {error.strerror}") from error

    def _there(self, names: Sequence[str]) -> Path | None:
        """Return the first file of these names that is there, which counts as used."""
        found = next((name for name in names if (self._path / name).is_file()), None)
        self._used.add(found or "")
        return None if found is None else self._path / found

    def _pictures(self, kind: str) -> list[Path] | None:
        """Return the pictures of the first existing folder, in natural order; None without one."""
        name = next((name for name in _FOLDERS[kind] if (self._path / name).is_dir()), None)
        if name is None:
            return None
        self._used.add(name)
        root, files, others = self._path.resolve(), list[Path](), list[str]()
        for file in islice((self._path / name).iterdir(), _MOST_FILES):
            if file.suffix.lower() in _PICTURES and _lies_in(root, file):
                files.append(file)
            elif not _IGNORED.search(file.name):
                others.append(file.name)
        if not files:
            self._notes.append(f"{name}/ has no pictures")
        if others:
            words = f"{len(others)} files in {name}/ that are no PNG or JPEG in this folder"
            self._notes.append(f"{words}: {listed(sorted(others), 3)}")
        return sorted(files, key=lambda file: natural_order(file.stem))

    def _lines(self, path: Path, pairs: int) -> list[list[StreamFrame]]:
        """Return the pictures of each line `seconds file ...` of a list; `#` starts a remark."""
        try:
            lines = islice(text_of(path.read_bytes()).splitlines(), _MOST_FILES)
        except OSError as error:
            raise InvalidRecordingError(f"{path}: cannot be read ({error}); correct it") from error
        root, result, skipped = self._path.resolve(), list[list[StreamFrame]](), list[str]()
        for line in lines:
            words = re.split(r"[,\s]+", line.strip(), maxsplit=0 if pairs > 1 else 1)
            if not words[0] or words[0].startswith("#"):
                continue
            times = [(_name_times([word]) or [_nanoseconds(word)])[0] for word in words[::2]]
            files = [self._path / word.strip().replace("\\", "/") for word in words[1::2]]
            whole = len(words) == 2 * pairs and None not in times
            if whole and all(_lies_in(root, file) for file in files):
                result.append([StreamFrame(time or 0, file)
                               for time, file in zip(times, files, strict=True)])  # fmt: skip
            else:
                skipped.append(line.strip())
        words = f"{len(skipped)} lines are not `{('seconds file ' * pairs).strip()}`"
        if skipped and not result:
            remedy = "write a time and a file in this folder, or remove the list"
            raise InvalidRecordingError(f"{path}: {words}, such as {skipped[0][:80]!r}; {remedy}")
        if skipped:
            self._notes.append(f"{path.name}: {words}, left out: {listed(skipped, 2)[:80]}")
        return result

    def _tum(
        self, depth_list: Path, color_list: Path | None, color_files: list[Path] | None
    ) -> dict[str, list[StreamFrame]]:
        streams = {"depth": [frame for (frame,) in self._lines(depth_list, 1)]}
        if color_list is not None:
            streams["color"] = [frame for (frame,) in self._lines(color_list, 1)]
        elif color_files and (color := self._like(color_files, streams, "color")):
            streams["color"] = color
        return streams

    def _associated(self, path: Path) -> dict[str, list[StreamFrame]]:
        """Return the pairs of a list, at the times of depth."""
        streams: dict[str, list[StreamFrame]] = {"depth": [], "color": []}
        for pair in self._lines(path, 2):
            pair.sort(key=lambda frame: frame.place.parent.name not in _FOLDERS["depth"])
            streams["depth"].append(pair[0])
            streams["color"].append(replace(pair[1], time_ns=pair[0].time_ns))
        self._notes.append(f"pairs as listed in {path.name}")
        return streams

    def _numbered(self, files: Mapping[str, list[Path] | None]) -> dict[str, list[StreamFrame]]:
        """Return the frames of pictures whose names tell their order, or their times."""
        pictures = {kind: files[kind] or [] for kind in ("depth", "color") if files[kind]}
        times = {kind: _name_times([one.stem for one in each]) for kind, each in pictures.items()}
        if self._options.fps is None and pictures and all(times.values()):
            self._notes.append("the names of the pictures are their times")
        else:
            fps = self._options.fps or (None if self._lens is None else self._lens.fps)
            if fps is None:
                raise InvalidRecordingError(f"{self._path}: {self._missing(files=False)}")
            keys = self._matched({kind: _keys(each) for kind, each in pictures.items()}, pictures)
            # Pictures of the same key belong to the same moment, even if one of them is missing.
            every = sorted({key for each in keys.values() for key in each}, key=natural_order)
            moment = {key: round(1e9 * number / fps) for number, key in enumerate(every)}
            times = {kind: [moment[key] for key in each] for kind, each in keys.items()}
            first, last = (every[0], every[-1]) if every else ("", "")
            if first.isdigit() and last.isdigit() and (
                len(every) < int(last) - int(first) + 1 < _MOST_FILES
            ):  # fmt: skip
                gaps = f"the numbers of the pictures run from {first} to {last} with gaps"
                self._notes.append(f"{gaps}: the {len(every)} there were taken without one")
            self._notes.append(f"no time stamps: pictures taken as {fps:g} per second")
        return {"depth": []} | {
            kind: sorted(map(StreamFrame, times[kind] or (), each), key=lambda one: one.time_ns)
            for kind, each in pictures.items()
        }

    def _matched(
        self, keys: dict[str, list[str]], pictures: Mapping[str, list[Path]]
    ) -> dict[str, list[str]]:
        """Return keys by which depth and color belong together, by name or else by position."""
        if len(keys) < 2:
            return keys
        depth, color = keys["depth"], keys["color"]
        shared, alike = {*depth} & {*color}, {*depth} == {*color}
        names = listed([each[0].name for each in pictures.values()])
        words = f"the names of depth and color differ ({names})"
        stems = [{file.stem for file in each} for each in pictures.values()]
        if not alike and len(depth) == len(color) and (not shared or _is_shifted(depth, color)):
            self._notes.append(f"{words}: the {len(depth)} of each were paired by position")
            return {"depth": depth, "color": depth}
        if 2 * len(shared) < min(len(depth), len(color)):
            raise InvalidRecordingError(
                f"{self._path}: {words}: {len(shared)} agree of {len(depth)} depth and "
                f"{len(color)} color pictures; are these several takes? name those of one moment "
                "alike, or list the pairs in associations.txt (seconds file seconds file)"
            )
        if alike and stems[0] != stems[1]:
            self._notes.append(f"{words}: the pictures were paired by their numbers")
        return keys

    def _like(
        self, files: list[Path], streams: Mapping[str, list[StreamFrame]], kind: str
    ) -> list[StreamFrame]:
        """Return the pictures at the times of those of the same name, or else by position."""
        depth, mine = streams["depth"], _keys(files)
        moments = [frame.time_ns for frame in depth]
        names = {frame.place.stem: frame.time_ns for each in streams.values() for frame in each}
        numbers = dict(zip(_keys([frame.place for frame in depth]), moments, strict=True))
        tries = [([file.stem for file in files], names), (mine, numbers)]
        if len(mine) == len(depth) and {*mine} != {*numbers} and _is_shifted([*numbers], mine):
            tries = []
        for keys, known in tries:
            found = [StreamFrame(known[key], file)
                     for key, file in zip(keys, files, strict=True) if key in known]  # fmt: skip
            if found:
                break
        else:
            found = list(map(StreamFrame, moments, files)) if len(files) == len(depth) else []
            if found:
                self._notes.append(f"the {len(files)} pictures of {kind} were matched by position")
        if lost := len(files) - len(found):
            words = f"{lost} of {len(files)} pictures of {kind} with the name of none of depth"
            self._notes.append(f"{words} were left out; name those of one moment alike")
        return found

    def _missing(self, *, files: bool) -> str:
        """Return everything that a folder does not specify, and how to specify it."""
        options, lens = self._options, self._lens
        is_bop, wanted = lens is None and self._is_bop, dict[str, str]()
        if not files and not (options.fps or (lens is not None and lens.fps)):
            wanted["when the pictures were taken"] = "--fps"
        if lens is None and not is_bop:
            looked_for = f"the intrinsics (looked for {', '.join((*_INTRINSICS, _BOP))})"
            wanted[looked_for] = "--intrinsics FILE (JSON: width, height, fx, fy, cx, cy)"
        if options.depth_unit_m is None and not (is_bop or (lens is not None and lens.unit)):
            wanted["how long a unit of depth is"] = (
                "--depth-unit-m (0.001 for millimeters, 0.0002 for the data sets of TUM)"
            )
        return f"nothing says {' or '.join(wanted)}; give {' and '.join(wanted.values())}"

    def _bop(self) -> IntrinsicsFile:
        """Return the intrinsics and the unit of `scene_camera.json`, the same for every picture."""
        path = self._path / _BOP
        content = read_json(path)
        entries = list(content.values()) if isinstance(content, dict) else []
        numbers = np.array([_bop_entry(path, entry) for entry in entries])
        if not len(numbers):
            raise InvalidRecordingError(f"{path}: no picture is described; see docs/import.md")
        change = np.abs(numbers - numbers[0]).max(axis=0)
        if change[:5].max() > 1e-6 or change[5:].max() > _MOST_MOVED_M:
            what = f"the camera moves by {change[5:8].max():.3f} m or turns (cam_t_w2c, cam_R_w2c)"
            if change[:5].max() > 1e-6:
                what = "cam_K or depth_scale changes from picture to picture"
            remedy = "a recording has one fixed camera: split the scene"
            raise InvalidRecordingError(f"{path}: {what}; {remedy}")
        fx, fy, cx, cy, scale = numbers[0, :5].tolist()
        if not (fx > 0 and fy > 0 and 0 < scale < 1e6):
            raise InvalidRecordingError(f"{path}: cam_K or depth_scale is not positive; correct it")
        for file in self._pictures("depth") or ():
            with suppress(TruncatedError):
                height, width = png_depth(self._bytes(file)).shape
                one = Intrinsics(width, height, fx, fy, cx, cy)
                unit = DepthUnit(scale * 1e-3, f"depth_scale {scale:g} in {_BOP}")
                return IntrinsicsFile(path, one, one, np.eye(4), None, unit)
        raise InvalidRecordingError(f"{self._path}: no 16-bit PNG of depth can be read; add one")


def _bop_entry(path: Path, entry: Any) -> list[float]:
    """Return fx, fy, cx, cy, the scale, and the camera's place [m]."""
    try:
        k, scale = [float(value) for value in entry["cam_K"]], float(entry["depth_scale"])
        place = [float(value) * 1e-3 for value in entry.get("cam_t_w2c", (0.0, 0.0, 0.0))]
        turn = [float(value) for value in entry.get("cam_R_w2c", np.eye(3).ravel())]
        return [k[0], k[4], k[2], k[5], scale, *place[:3], *turn[:9]]
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        words = "an entry has no cam_K of nine numbers or no depth_scale; correct it"
        raise InvalidRecordingError(f"{path}: {words}") from error


def _keys(files: Sequence[Path]) -> list[str]:
    """Return the part of each name that tells pictures of one folder apart, without leading zeros.

    What comes before the first and after the last digit goes where all names share it.
    """
    stems = [file.stem for file in files]
    if times := _name_times(stems):
        return [f"{time:020d}" for time in times]
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


def _name_times(stems: Sequence[str]) -> list[int] | None:
    """Return the times that names tell [ns]; None if they are no times.

    They are seconds, most with decimals, or since 1970: 13, 16, 19 digits count ms, us, ns.
    """
    for pattern in (r"(?:\D*[_-](?=\d{9}))?(\d{1,10}(?:\.\d*)?)",
                    r"(?:\D*[_-])?(\d{9,10})[_-](\d{9})",
                    r"(?:\D*[_-])?([1-4]\d{12}|[1-4]\d{15}|[1-4]\d{18})"):  # fmt: skip
        found = [match.groups() for stem in stems if (match := re.fullmatch(pattern, stem))]
        if not stems or len(found) < len(stems):
            continue
        if len(found[0]) > 1:
            return [int(seconds) * 10**9 + int(rest) for seconds, rest in found]
        words = [word for (word,) in found]
        if len(words[0]) in (13, 16, 19) and "." not in words[0]:
            return [int(word) * 10 ** (19 - len(word)) for word in words]
        if 2 * sum("." in word for word in words) > len(words):
            return [_nanoseconds(word) or 0 for word in words]
    return None


def _lies_in(folder: Path, file: Path) -> bool:
    try:
        return file.resolve().is_relative_to(folder)
    except (OSError, ValueError, RuntimeError):
        return False


def _nanoseconds(word: str) -> int | None:
    """Return a decimal number of seconds as exact nanoseconds."""
    match = re.fullmatch(r"(\d{1,10})(?:\.(\d*))?", word)
    return match and int(match[1]) * 10**9 + int((match[2] or "").ljust(9, "0")[:9])
