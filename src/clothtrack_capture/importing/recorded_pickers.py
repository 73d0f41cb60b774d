"""The pickers of an import: brought to the world and the recording's clock, with their actions."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack.recordings.recording import PickAndPlace, PickerPath
from clothtrack.recordings.store import RecordingWriter
from clothtrack_capture.importing.picker_paths import (
    actions_in_words,
    actions_of,
    on_recording_clock,
    read_path_table,
)
from clothtrack_capture.importing.source import Streams


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
    """Return the paths in the world and on the recording's clock, and what to know about them.

    Args:
        source: the source, for errors.
        streams: what the source holds, its paths among it.
        table: CSV file with a path, in the world.
        clock: "recording" or "source", the clock of that file.
        pose: world_from_camera.
        start_ns: time of the first frame on the source's clock [ns].
        posed: whether that pose is known, or the camera's frame stands in for the world.

    Raises:
        InvalidConfigError: nothing ties a path to the world, or it and the frames do not meet.
    """
    span = [0.0, (max(frame.time_ns for frame in streams.depth) - start_ns) / 1e9]
    if table is not None:
        paths = read_path_table(table)
        moved = on_recording_clock(
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
    return on_recording_clock(paths, start_s, span, "record both with the same clock"), notes


def add_pickers(
    writer: RecordingWriter,
    paths: Mapping[str, PickerPath],
    frame_times: Sequence[float],
    words: Sequence[str],
) -> tuple[list[PickAndPlace], list[str]]:
    """Write the paths and the actions that they or a person tell.

    Raises:
        InvalidConfigError: an action is impossible.
    """
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


def _moved(path: PickerPath, pose: Float[np.ndarray, "4 4"]) -> PickerPath:
    positions = path.positions @ pose[:3, :3].T + pose[:3, 3]
    return PickerPath(path.time_s, positions, path.closed)
