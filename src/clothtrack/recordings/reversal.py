"""A recording backwards: what is known at its end can be followed to its beginning.

A flattening episode begins with a crumpled cloth, which is hard to reconstruct, and ends with a
flatter one, which is easy. Cloth moved slowly does nearly the same either way; what it does not,
such as falling, each picture corrects.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from clothtrack.recordings.recording import PickerPath, Recording
from clothtrack.recordings.store import RecordingWriter, read_recording


def reversed_recording(recording: Recording, out: Path) -> Recording:
    """Write the recording with its last frame first; one that is there already is read.

    Frame k becomes frame n - 1 - k, and a picker opens where it closed. A template is left out: it
    lies where the cloth was in the first frame, which is now the last.

    Args:
        recording: to be turned around.
        out: folder of the new recording.

    Raises:
        InvalidRecordingError: a picture cannot be read.
        StorageError: the disk refuses.
    """
    if (out / "recording.json").exists():
        return read_recording(out)
    frames = recording.frames[::-1]
    end_s, last = frames[0].time_s, len(frames) - 1
    cloth = replace(recording.cloth, template=None, held_vertices={})
    provenance = {**recording.provenance, "reversed": recording.name}
    with RecordingWriter(
        out, recording.cameras, recording.depth_units_m, table=recording.table, cloth=cloth,
        observed=recording.observed, provenance=provenance,
    ) as writer:  # fmt: skip
        for frame in frames:
            writer.copy_frame(frame, end_s - frame.time_s)
        for name, path in recording.picker_paths.items():
            writer.set_picker_path(name, reversed_path(path, end_s))
        for action in recording.actions[::-1]:
            writer.add_action(last - action.last_frame, last - action.first_frame, action.pickers)
    return read_recording(out)


def reversed_path(path: PickerPath, end_s: float) -> PickerPath:
    """Return the tip's path backwards.

    Args:
        path: forwards; between a sample and the next it is as closed as the sample says.
        end_s: the time that becomes 0 [s].
    """
    closed = np.append(path.closed[-2::-1], path.closed[0])
    return PickerPath(end_s - path.time_s[::-1], path.positions[::-1], closed)
