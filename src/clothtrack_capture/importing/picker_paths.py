"""Picker paths of an import, on the recording's clock, and their actions."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.recordings.picker_table import COLUMNS, read_picker_paths
from clothtrack.recordings.recording import PickAndPlace, PickerPath, actions_of
from clothtrack.recordings.store import RecordingWriter
from clothtrack_capture.importing.source import Streams

_NAMES = {
    "time": ("time", "time_s", "t", "timestamp", "stamp"),
    "x": ("x", "x_m"),
    "y": ("y", "y_m"),
    "z": ("z", "z_m"),
    "closed": ("closed", "gripper_closed", "grasped"),
}
_LARGEST_FILE = 256 * 2**20


def placed_paths(
    source: Path,
    streams: Streams,
    table: Path | None,
    clock: str,
    *,
    pose: Float[np.ndarray, "4 4"],
    start_ns: int,
    posed: bool,
) -> tuple[dict[str, PickerPath], list[str]]:
    """Return the paths in the world and on the recording's clock, and remarks about them.

    Args:
        source: path of the source, for error messages.
        streams: content of the source, including its paths.
        table: CSV file with a path in the world.
        clock: clock of that file, "recording" or "source".
        pose: transform world_from_camera.
        start_ns: time of the first frame on the source's clock [ns].
        posed: whether that pose is known; otherwise the camera's frame is used as the world.
    """
    span = [0.0, (max(frame.time_ns for frame in streams.depth) - start_ns) / 1e9]
    if table is not None:
        paths = read_path_table(table)
        moved = _on_recording_clock(
            paths, start_ns / 1e9 if clock == "source" else 0.0, span,
            f"{table} was read on the clock of the {clock}; the first frame is at "
            f"{start_ns / 1e9:.3f} s "
            "of the source's clock; say --picker-clock source or recording",
        )  # fmt: skip
        frame = "the world" if posed else "the camera's frame, which stands in for the world"
        return moved, [f"the path in {table.name} was taken to be in {frame}"]
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
                "that to the camera; give the camera's pose in it: --world-from-camera FILE, or "
                "--world-frame where TF knows both"
            )
        notes.append(
            f"the picker's path in frame {streams.path_frame} was taken to be in the world"
        )
    start_s = (start_ns - streams.path_start_ns) / 1e9
    return _on_recording_clock(paths, start_s, span, "record both with the same clock"), notes


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


def read_path_table(path: Path) -> dict[str, PickerPath]:
    """Return the path per picker from a CSV file, with the file's times."""
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise InvalidRecordingError(f"{path}: larger than {_LARGEST_FILE} bytes; shorten it")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidRecordingError(f"{path}: cannot be read ({error}); check the file") from error
    try:
        return _paths_in(path, text)
    except csv.Error as error:
        raise InvalidRecordingError(f"{path}: not a CSV file ({error})") from error


def _paths_in(path: Path, text: str) -> dict[str, PickerPath]:
    rows = csv.reader(io.StringIO(text))
    head = [word.strip() for word in next(rows, [])]
    if head == [*COLUMNS]:
        return read_picker_paths(path)
    places = {
        name: next((k for k, word in enumerate(head) if word.lower() in spellings), None)
        for name, spellings in _NAMES.items()
    }
    missing = [name for name in ("time", "x", "y", "z") if places[name] is None]
    if missing:
        raise InvalidRecordingError(
            f"{path}: the first line is {','.join(head)[:200]!r}, without {', '.join(missing)}; "
            f"write {','.join(COLUMNS)} or time,x,y,z[,closed]"
        )
    chosen = [place for place in places.values() if place is not None]
    table = []
    for number, row in enumerate(rows, start=2):
        if not row:
            continue
        try:
            values = [_number(row[place]) for place in chosen]
        except (ValueError, IndexError) as error:
            raise InvalidRecordingError(
                f"{path}: line {number}: {','.join(row)[:80]!r} is not {len(chosen)} numbers"
            ) from error
        if table and values[0] <= table[-1][0]:
            raise InvalidRecordingError(
                f"{path}: line {number}: time {values[0]} is not after {table[-1][0]}; sort by time"
            )
        table.append(values)
    if len(table) < 2:
        raise InvalidRecordingError(f"{path}: {len(table)} positions; a path has at least two")
    array = np.array(table)
    closed = array[:, 4] > 0.5 if array.shape[1] > 4 else np.zeros(len(array), dtype=bool)
    return {"picker": PickerPath(array[:, 0], array[:, 1:4], closed)}


def _number(word: str) -> float:
    value = {"true": 1.0, "false": 0.0}.get(word.strip().lower())
    value = float(word) if value is None else value
    if not np.isfinite(value):
        raise ValueError(word)
    return value


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
        if path.time_s[-1] < frame_times[0] or path.time_s[0] > frame_times[-1]:
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
