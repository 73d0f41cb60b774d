"""Picker paths of an import, on the recording's clock, and their actions."""

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.recordings.picker_table import COLUMNS
from clothtrack.recordings.recording import PickAndPlace, PickerPath, actions_of
from clothtrack.recordings.store import RecordingWriter
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.intrinsics import text_of
from clothtrack_capture.importing.source import Streams, listed

_NAMES = {
    "time": ("time", "t", "timestamp", "stamp"),
    **{axis: (axis, f"pos_{axis}", f"position_{axis}") for axis in "xyz"},
    "closed": ("closed", "gripper_closed", "grasped"),
    "picker": ("picker",),
}
_SUFFIXES = {"_s": 1.0, "_ms": 1e-3, "_us": 1e-6, "_ns": 1e-9, "_m": 1.0, "_cm": 1e-2, "_mm": 1e-3}
_LARGEST_FILE = 256 * 2**20
_MUCH_LONGER, _LEAST_COVER = 20.0, 0.8
# Seconds since 1970 are below the first; times beyond are counts of a finer unit.
_EPOCHS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))


def placed_paths(
    source: Path,
    streams: Streams,
    options: ImportOptions,
    *,
    pose: Float[np.ndarray, "4 4"],
    span_ns: tuple[int, int],
    posed: bool,
) -> tuple[dict[str, PickerPath], list[str]]:
    """Return the paths in the world and on the recording's clock, and remarks about them.

    `pose` is world_from_camera, or else (not `posed`) the camera's frame stands in for the world;
    `span_ns` has the times of the first and the last frame on the source's clock.
    """
    first_ns, lasts_s = span_ns[0], (span_ns[1] - span_ns[0]) / 1e9
    if options.picker_csv is not None:
        paths, notes, start_s, remedy = _logged(options.picker_csv, options, first_ns, lasts_s)
        frame = "the world" if posed else "the camera's frame, which stands in for the world"
        notes.append(f"the path in {options.picker_csv.name} was taken to be in {frame}")
    else:
        paths, notes = dict(streams.paths), []
        if streams.path_frame == "camera":
            paths = {name: replace(one, positions=one.positions @ pose[:3, :3].T + pose[:3, 3])
                     for name, one in paths.items()}  # fmt: skip
        elif paths and streams.path_frame != "world":
            words = f"the picker's path in frame {streams.path_frame}"
            if not posed:
                raise InvalidConfigError(
                    f"{source}: nothing ties {words} to the camera; give the camera's pose in it "
                    "with --world-from-camera FILE"
                )
            notes.append(f"{words} was taken to be in the world")
        start_s = (first_ns - streams.path_start_ns) / 1e9
        again = "record both with the same clock"
        remedy = "give --stamps written" if options.stamps == "header" else again
    paths = {name: replace(path, time_s=path.time_s - start_s) for name, path in paths.items()}
    for name, path in paths.items():
        start, stop = path.time_s[[0, -1]].tolist()
        words = f"the path of {name!r} lasts from {start:.3f} to {stop:.3f} s of the recording"
        if not _meets(path.time_s, lasts_s):
            raise InvalidConfigError(f"{words}, the frames from 0 to {lasts_s:.3f} s; {remedy}")
        if min(stop, lasts_s) - max(start, 0.0) < _LEAST_COVER * lasts_s:
            notes.append(f"{words}, which has {lasts_s:.3f} s")
        if stop - start > _MUCH_LONGER * max(lasts_s, 1e-3):
            notes.append(f"{words}, in seconds; name another unit with the column, such as time_ms")
    return paths, notes


def _logged(
    path: Path, options: ImportOptions, first_ns: int, lasts_s: float
) -> tuple[dict[str, PickerPath], list[str], float, str]:
    """Return a log's paths, remarks, the first frame on its clock [s], and what else may help."""
    paths, notes = read_path_table(path)
    starts, clock = {"recording": 0.0, "source": first_ns / 1e9}, options.picker_clock
    other = "recording" if clock == "source" else "source"
    first = f"the first frame is at {first_ns / 1e9:.3f} s of the source's clock"
    remedy = f"{first}; write the path's times on that clock, or from the first frame on"
    if all(_meets(path.time_s - starts[other], lasts_s) for path in paths.values()):
        remedy = f"{path} was read on the clock of the {clock}; give --picker-clock {other}"
    return paths, notes, starts[clock], remedy


def _meets(times: np.ndarray, lasts_s: float) -> bool:
    return bool(times[-1] >= 0 and times[0] <= lasts_s)


def add_pickers(
    writer: RecordingWriter, paths: Mapping[str, PickerPath], frame_times: Sequence[float],
    words: Sequence[str],
) -> tuple[list[PickAndPlace], list[str]]:  # fmt: skip
    """Write the paths, and the actions given by them or by the user."""
    for name, path in paths.items():
        writer.set_picker_path(name, path)
    actions, lost = actions_of(paths, frame_times)
    if words:
        actions, lost = actions_in_words(words, len(frame_times), list(paths)), 0
    notes = [f"{lost} closures of a picker give no action: no two frames show them"] if lost else []
    for action in actions:
        writer.add_action(action.first_frame, action.last_frame, action.pickers)
    return actions, notes


def read_path_table(path: Path) -> tuple[dict[str, PickerPath], list[str]]:
    """Return the path per picker from a CSV file, with the file's times, and remarks."""
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise InvalidRecordingError(f"{path}: larger than {_LARGEST_FILE} bytes; shorten it")
        text = text_of(path.read_bytes())
    except OSError as error:
        raise InvalidRecordingError(f"{path}: cannot be read ({error}); check the file") from error
    lines = text.splitlines()
    begin = next((k for k, line in enumerate(lines) if line.strip() and line[0] != "#"), 0)
    if begin and re.match(r"[-+.\d]", lines[begin]):
        begin -= 1  # the names of the columns are a remark
    head = lines[begin].lstrip("# ") if lines else ""
    separator = max(",;\t", key=head.count)
    try:
        return _paths_in(path, [word.strip() for word in head.split(separator)], begin + 2,
                         csv.reader(lines[begin + 1 :], delimiter=separator),
                         "." if separator == "," else ",")  # fmt: skip
    except csv.Error as error:
        raise InvalidRecordingError(f"{path}: not a CSV file ({error}); correct it") from error


def _column(word: str) -> tuple[str, float] | None:
    """Return what a column holds, and its unit; None if it is not known."""
    word = word.lower()
    suffix = next((one for one in _SUFFIXES if word.endswith(one)), "")
    for name, spellings in _NAMES.items():
        if word in spellings or word.removesuffix(suffix) in spellings:
            return name, _SUFFIXES.get(suffix, 1.0)
    return None


def _paths_in(
    path: Path, head: list[str], begin: int, rows: Iterable[list[str]], decimal: str
) -> tuple[dict[str, PickerPath], list[str]]:
    columns = {known[0]: (place, known[1]) for place, word in reversed([*enumerate(head)])
               if (known := _column(word)) is not None}  # fmt: skip
    missing = [name for name in ("time", "x", "y", "z") if name not in columns]
    if missing:
        raise InvalidRecordingError(
            f"{path}: the first line is {','.join(head)[:200]!r}, without {', '.join(missing)}; "
            f"write {','.join(COLUMNS)} or time,x,y,z[,closed]"
        )
    used = [place for place, _ in columns.values()]
    unused = [word for place, word in enumerate(head) if place not in used]
    notes = [f"columns of {path.name} that were not used: {listed(unused)}"] if unused else []
    named, _ = columns.pop("picker", (None, 1.0))
    order = [columns[name] for name in ("time", "x", "y", "z", "closed") if name in columns]
    tables, doubles = dict[str, list[list[float]]](), 0
    for number, row in enumerate(rows, start=begin):
        if not "".join(row).strip() or row[0].startswith("#"):
            continue
        try:
            sample = [_number(row[place], decimal) * scale for place, scale in order]
            name = "picker" if named is None else row[named].strip()
        except (ValueError, IndexError) as error:
            raise InvalidRecordingError(
                f"{path}: line {number}: {','.join(row)[:80]!r} is not {len(order)} numbers; "
                "correct the line or delete it"
            ) from error
        table = tables.setdefault(name, [])
        if table and sample[0] < table[-1][0]:
            raise InvalidRecordingError(
                f"{path}: line {number}: time {sample[0]:g} is before {table[-1][0]:g}, the row "
                "before; sort by time, or cut the file there if a clock was set back"
            )
        if table and sample[0] == table[-1][0]:
            doubles += 1
            table.pop()
        table.append(sample)
    paths = {name: _path_of(path, name, np.array(table), notes)
             for name, table in (tables or {"picker": []}).items()}  # fmt: skip
    if doubles:
        finest = min(float(np.diff(one.time_s).min()) for one in paths.values())
        notes.append(
            f"{doubles} rows of {path.name} repeat the time of the row before and replace it: its "
            f"times have a resolution of {finest:g} s, so the path may be wrong by that long"
        )
    return paths, notes


def _path_of(path: Path, name: str, table: np.ndarray, notes: list[str]) -> PickerPath:
    """Return the path in rows of time, x, y, z and perhaps `closed`; add remarks."""
    if len(table) < 2:
        words = f"{len(table)} positions of {name!r} at different times"
        raise InvalidRecordingError(f"{path}: {words}; a path has at least two: log more")
    scale = next((unit for most, unit in _EPOCHS if table[0, 0] > most), 1.0)
    if scale != 1.0:
        notes.append(f"the times of {path.name} were taken to be {1 / scale:.0e} per second")
    closed = table[:, 4] if table.shape[1] > 4 else np.zeros(len(table))
    if not np.isin(closed, (-1, 0, 1)).all():
        raise InvalidRecordingError(
            f"{path}: `closed` of {name!r} has values from {closed.min():g} to {closed.max():g}; "
            "write 1 where the picker is closed and 0 where it is open"
        )
    if table.shape[1] > 4 and np.ptp(closed) == 0:
        notes.append(f"`closed` of {name!r} is {closed[0]:g} all the time")
    return PickerPath(table[:, 0] * scale, table[:, 1:4], closed > 0.5)


def _number(word: str, decimal: str) -> float:
    value = {"true": 1.0, "false": 0.0}.get(word.strip().lower())
    value = float(word.replace(decimal, ".")) if value is None else value
    if not np.isfinite(value):
        raise ValueError(word)
    return value


def actions_in_words(
    words: Sequence[str], frames: int, pickers: Sequence[str]
) -> list[PickAndPlace]:
    """Return the actions given as first and last frame, such as "10-50"."""
    actions: list[PickAndPlace] = []
    for word in words:
        if not re.fullmatch(r"\d{1,9}-\d{1,9}", word):
            raise InvalidConfigError(f"--actions {word!r}: write first and last frame, as in 10-50")
        first, last = map(int, word.split("-"))
        before = actions[-1].last_frame if actions else 0
        if not before <= first < last < frames:
            raise InvalidConfigError(
                f"--actions {word!r}: frames run from 0 to {frames - 1}, actions follow each other "
                f"(the one before ends at {before}) and take at least two frames"
            )
        actions.append(PickAndPlace(first, last, tuple(pickers)))
    if actions and not pickers:
        wanted = "give --picker-csv, --picker-topic or --picker-frame"
        raise InvalidConfigError(f"--actions without a picker's path: {wanted}")
    return actions
