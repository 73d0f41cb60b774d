"""Picker paths of an import, on the recording's clock, and their actions."""

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.recordings.picker_table import COLUMNS
from clothtrack.recordings.recording import PickAndPlace, PickerPath, actions_of
from clothtrack.recordings.store import RecordingWriter
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.intrinsics_file import text_of
from clothtrack_capture.importing.source import Streams, listed

_NAMES = {
    "time": ("time", "t", "timestamp", "stamp"),
    "x": ("x", "pos_x", "position_x"),
    "y": ("y", "pos_y", "position_y"),
    "z": ("z", "pos_z", "position_z"),
    "closed": ("closed", "gripper_closed", "grasped"),
    "picker": ("picker",),
}
_SUFFIXES = {"_s": 1.0, "_ms": 1e-3, "_us": 1e-6, "_ns": 1e-9, "_m": 1.0, "_cm": 1e-2, "_mm": 1e-3}
_LARGEST_FILE = 256 * 2**20
_MUCH_LONGER = 300.0


def placed_paths(
    source: Path,
    streams: Streams,
    options: ImportOptions,
    *,
    pose: Float[np.ndarray, "4 4"],
    first_ns: int,
    last_ns: int,
    posed: bool,
) -> tuple[dict[str, PickerPath], list[str]]:
    """Return the paths in the world and on the recording's clock, and remarks about them.

    Args:
        source: path of the source, for error messages.
        streams: content of the source, including its paths.
        options: options with the CSV file of a path and its clock.
        pose: transform world_from_camera.
        first_ns: time of the first frame on the source's clock [ns].
        last_ns: time of the last frame on the source's clock [ns].
        posed: whether that pose is known; otherwise the camera's frame is used as the world.
    """
    span = [0.0, (last_ns - first_ns) / 1e9]
    table = options.picker_csv
    if table is not None:
        paths, notes = read_path_table(table)
        shifts = {"recording": 0.0, "source": first_ns / 1e9}
        other = "recording" if options.picker_clock == "source" else "source"
        remedy = (
            f"the first frame is at {first_ns / 1e9:.3f} s of the source's clock; write the path's "
            "times on that clock, or from the first frame on"
        )
        if all(_meet(path.time_s - shifts[other], span) for path in paths.values()):
            remedy = (
                f"{table} was read on the clock of the {options.picker_clock}; give --picker-clock "
                f"{other}"
            )
        moved = _on_recording_clock(paths, shifts[options.picker_clock], span, remedy)
        frame = "the world" if posed else "the camera's frame, which stands in for the world"
        for name, path in moved.items():
            if (lasts_s := np.ptp(path.time_s)) > _MUCH_LONGER * max(span[1], 1e-3):
                notes.append(
                    f"the path of {name!r} lasts {lasts_s:g} s, the frames {span[1]:g} s; if its "
                    "times are milliseconds, call the column time_ms"
                )
        return moved, [*notes, f"the path in {table.name} was taken to be in {frame}"]
    if not streams.paths:
        return {}, []
    notes = []
    paths = dict(streams.paths)
    if streams.path_frame == "camera":
        paths = {name: _moved(path, pose) for name, path in paths.items()}
    elif streams.path_frame != "world":
        if not posed:
            raise InvalidConfigError(
                f"{source}: the picker's path is in frame {streams.path_frame}, and nothing ties "
                "that to the camera; give the camera's pose in it: --world-from-camera FILE"
            )
        notes.append(
            f"the picker's path in frame {streams.path_frame} was taken to be in the world"
        )
    start_s = (first_ns - streams.path_start_ns) / 1e9
    remedy = "record both with the same clock"
    if options.stamps == "header":
        remedy = "where they have two clocks, give --stamps written"
    return _on_recording_clock(paths, start_s, span, remedy), notes


def add_pickers(
    writer: RecordingWriter,
    paths: Mapping[str, PickerPath],
    frame_times: Sequence[float],
    words: Sequence[str],
) -> tuple[list[PickAndPlace], list[str]]:
    """Write the paths, and the actions given by them or by the user."""
    for name, path in paths.items():
        writer.set_picker_path(name, path)
    notes = []
    if words:
        actions = actions_in_words(words, len(frame_times), list(paths))
    else:
        actions, left_out = actions_of(paths, frame_times)
        if left_out:
            notes.append(f"{left_out} closures of a picker give no action: no two frames show them")
    for action in actions:
        writer.add_action(action.first_frame, action.last_frame, action.pickers)
    return actions, notes


def read_path_table(path: Path) -> tuple[dict[str, PickerPath], list[str]]:
    """Return the path per picker from a CSV file, with the file's times, and remarks.

    The columns are those of `picker.csv`, or `time, x, y, z` and optionally `closed`, in any order,
    in seconds and meters; a name may end with another unit (`time_ms`, `x_mm`).

    Raises:
        InvalidRecordingError: the file cannot be read, a column is missing or a field is not a
            number.
    """
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
                         csv.reader(lines[begin + 1 :], delimiter=separator))  # fmt: skip
    except csv.Error as error:
        raise InvalidRecordingError(f"{path}: not a CSV file ({error})") from error


def _column(word: str) -> tuple[str, float] | None:
    """Return what a column holds, and its unit; None if it is not known."""
    word = word.lower()
    suffix = next((one for one in _SUFFIXES if word.endswith(one)), "")
    for name, spellings in _NAMES.items():
        if word in spellings or word.removesuffix(suffix) in spellings:
            return name, _SUFFIXES.get(suffix, 1.0)
    return None


def _paths_in(
    path: Path, head: list[str], begin: int, rows: Iterable[list[str]]
) -> tuple[dict[str, PickerPath], list[str]]:
    columns = {known[0]: (place, known[1]) for place, word in reversed([*enumerate(head)])
               if (known := _column(word)) is not None}  # fmt: skip
    missing = [name for name in ("time", "x", "y", "z") if name not in columns]
    if missing:
        raise InvalidRecordingError(
            f"{path}: the first line is {','.join(head)[:200]!r}, without {', '.join(missing)}; "
            f"write {','.join(COLUMNS)} or time,x,y,z[,closed]"
        )
    unused = [word for place, word in enumerate(head)
              if place not in [known for known, _ in columns.values()]]  # fmt: skip
    notes = [f"columns of {path.name} that were not used: {listed(unused)}"] if unused else []
    named = columns.pop("picker", None)
    tables: dict[str, list[list[float]]] = {}
    doubles = 0
    for number, row in enumerate(rows, start=begin):
        if not "".join(row).strip() or row[0].startswith("#"):
            continue
        try:
            values = [_number(row[place]) * scale for place, scale in columns.values()]
            name = "picker" if named is None else row[named[0]].strip()
        except (ValueError, IndexError) as error:
            raise InvalidRecordingError(
                f"{path}: line {number}: {','.join(row)[:80]!r} is not {len(columns)} numbers"
            ) from error
        values = dict(zip(columns, values, strict=True))
        sample = [values["time"], values["x"], values["y"], values["z"], values.get("closed", 0.0)]
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
    arrays = {name: np.array(table) for name, table in tables.items()}
    for name, table in (arrays or {"picker": np.zeros((0, 5))}).items():
        if len(table) < 2:
            raise InvalidRecordingError(
                f"{path}: {len(table)} positions of {name!r} at different times; a path has at "
                "least two"
            )
    if doubles:
        finest = min(float(np.diff(table[:, 0]).min()) for table in arrays.values())
        notes.append(
            f"{doubles} rows of {path.name} repeat the time of the row before: its times have a "
            f"resolution of {finest:g} s; the last row of each time was kept, so the path may be "
            "wrong by that long"
        )
    return {
        name: PickerPath(table[:, 0], table[:, 1:4], table[:, 4] > 0.5)
        for name, table in arrays.items()
    }, notes


def _number(word: str) -> float:
    value = {"true": 1.0, "false": 0.0}.get(word.strip().lower())
    value = float(word) if value is None else value
    if not np.isfinite(value):
        raise ValueError(word)
    return value


def _meet(times: np.ndarray, span: Sequence[float]) -> bool:
    return bool(times[-1] >= span[0] and times[0] <= span[1])


def _on_recording_clock(
    paths: Mapping[str, PickerPath], start_s: float, frame_times: Sequence[float], remedy: str
) -> dict[str, PickerPath]:
    """Return the paths on the clock of the frames.

    Args:
        paths: paths with times on another clock.
        start_s: time of the first frame on that clock [s].
        frame_times: times of the frames [s].
        remedy: advice for the error message if they have no time in common.
    """
    moved = {
        name: PickerPath(path.time_s - start_s, path.positions, path.closed)
        for name, path in paths.items()
    }
    for name, path in moved.items():
        if not _meet(path.time_s, frame_times):
            raise InvalidConfigError(
                f"the path of {name!r} lasts from {path.time_s[0]:.3f} to {path.time_s[-1]:.3f} s "
                f"of the recording, the frames from {frame_times[0]:.3f} to {frame_times[-1]:.3f} "
                f"s; {remedy}"
            )
    return moved


def actions_in_words(
    words: Sequence[str], frames: int, pickers: Sequence[str]
) -> list[PickAndPlace]:
    """Return the actions given as first and last frame, such as "10-50"."""
    actions: list[PickAndPlace] = []
    for word in words:
        match = re.fullmatch(r"(\d{1,9})-(\d{1,9})", word)
        if match is None:
            raise InvalidConfigError(
                f"--actions {word!r}: write first and last frame, such as 10-50"
            )
        first, last = int(match[1]), int(match[2])
        before = actions[-1].last_frame if actions else 0
        if not before <= first < last < frames:
            raise InvalidConfigError(
                f"--actions {word!r}: frames run from 0 to {frames - 1}, actions follow each other "
                f"(the one before ends at {before}) and take at least two frames"
            )
        actions.append(PickAndPlace(first, last, tuple(pickers)))
    if actions and not pickers:
        raise InvalidConfigError(
            "--actions without a picker's path: give --picker-csv, --picker-topic or --picker-frame"
        )
    return actions


def _moved(path: PickerPath, pose: Float[np.ndarray, "4 4"]) -> PickerPath:
    positions = path.positions @ pose[:3, :3].T + pose[:3, 3]
    return PickerPath(path.time_s, positions, path.closed)
