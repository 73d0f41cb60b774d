"""The digest of everything that is read from a recording."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from clothtrack.files.atomic_write import content_hash, storage
from clothtrack.recordings.frame_files import PICTURE_KINDS
from clothtrack.recordings.picker_table import PICKER_FILE
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.violation import DOCUMENT

DIGEST_FIELD = "recording_sha256"
"""Field of a result's provenance that has the digest of its recording."""

_PLAIN = ("kind", "color", "size_m", "grasp_uncertainty_m")
"""Fields of a cloth that are plain words or numbers."""


def recording_digest(recording: Recording) -> str:
    """Return the SHA-256 over the content of every file that a recording is read from.

    These are the document, the pickers' paths, the template, and all pictures and clouds. The
    location of the folder and its other files do not count. For a recording in memory, the same
    content is hashed, array by array and file by file.
    """
    if recording.in_memory:
        return _digest_in_memory(recording)
    folder = recording.folder
    with storage(folder / DOCUMENT):
        cloth = json.loads((folder / DOCUMENT).read_bytes()).get("cloth", {})
    files = [folder / DOCUMENT]
    if (folder / PICKER_FILE).exists():
        files.append(folder / PICKER_FILE)
    files += [folder / cloth[n] for n in ("template", "template_canonical") if cloth.get(n)]
    for frame in recording.frames:
        files += [path for kind in PICTURE_KINDS for path in getattr(frame, kind).values()]
        files += [frame.cloud] if frame.cloud is not None else []
    lines = "".join(
        f"{content_hash(path)}  {path.relative_to(folder).as_posix()}\n" for path in files
    )
    return hashlib.sha256(lines.encode()).hexdigest()


def array_digest(values: np.ndarray) -> str:
    """Return the SHA-256 of an array's type, shape and values, in hexadecimal digits."""
    described = f"{values.dtype.str} {values.shape}".encode()
    return hashlib.sha256(described + np.ascontiguousarray(values).tobytes()).hexdigest()


def _digest_in_memory(recording: Recording) -> str:
    """Return the SHA-256 over all that a recording in memory holds."""
    cloth, table, template = recording.cloth, recording.table, recording.cloth.template
    lines = [f"{name} {value}" for name, value in vars(cloth).items() if name in _PLAIN]
    lines += [f"{action}" for action in recording.actions]
    arrays: list[Any] = [] if table is None else [table.point, table.normal]
    if template is not None:
        arrays += [template.vertices, template.faces]
        arrays += [] if template.canonical is None else [template.canonical]
    arrays += [np.asarray(held) for held in cloth.held_vertices.values()]
    for camera in recording.cameras:
        lines.append(f"{camera.name} {camera.width} {camera.height}")
        lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        arrays += [lens, camera.world_from_camera]
    for path in recording.picker_paths.values():
        arrays += [path.time_s, path.positions, path.closed]
    arrays.append(np.array([frame.time_s for frame in recording.frames]))
    for frame in recording.frames:
        arrays += [shown for kind in PICTURE_KINDS for shown in getattr(frame, kind).values()]
        arrays += [frame.cloud] if frame.cloud is not None else []
    lines += [content_hash(one) if isinstance(one, Path) else array_digest(one) for one in arrays]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()
