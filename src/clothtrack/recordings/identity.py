"""The digest of all that is read from a recording."""

import hashlib
import json

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
