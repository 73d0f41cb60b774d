"""By what a recording is known again: a digest of all that is read from it, or its pictures."""

import hashlib
import json
from pathlib import Path

from clothtrack.files.atomic_write import content_hash, storage
from clothtrack.recordings.frame_files import PICTURE_KINDS
from clothtrack.recordings.picker_table import PICKER_FILE
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.violation import DOCUMENT

DIGEST_FIELD = "recording_sha256"
"""Where the provenance of a result has the digest of its recording."""


def recording_digest(recording: Recording) -> str:
    """Return the SHA-256 over the content of every file that a recording is read from.

    The document, the pickers' paths, the template and all pictures and clouds. Where the folder
    lies does not count, and neither do its other files.

    Raises:
        StorageError: a file cannot be read.
    """
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


def picture_digests(recording: Recording) -> frozenset[str]:
    """Return the SHA-256 of every file that shows what was measured; nothing is decoded.

    Of each frame its depth pictures count; its cloud where there are none, its colour where there
    is nothing else. A mask is no picture: the same one may be drawn twice. A picture that another
    program has compressed anew is another file.

    Raises:
        StorageError: a file cannot be read.
    """
    files: list[Path] = []
    for frame in recording.frames:
        clouds = [] if frame.cloud is None else [frame.cloud]
        files += list(frame.depth.values()) or clouds or list(frame.color.values())
    return frozenset(map(content_hash, files))


def same_film(one: frozenset[str], other: frozenset[str]) -> bool:
    """Return whether two recordings show the same moments, whatever their names and documents say.

    So does a part of a recording, or one with another template, or turned around. Two pictures
    decide: a single one, in which nothing was measured, may be the same anywhere.

    Args:
        one: `picture_digests` of a recording.
        other: of another.
    """
    return len(one & other) >= max(1, min(2, len(one), len(other)))
