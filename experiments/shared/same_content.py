"""Digests of a folder's content that are equal for two runs of the same work.

Values that may differ are left out: CPU times, clocks, processes, and digests of these.
"""

import hashlib
import io
import json
import re
import zipfile
from pathlib import Path
from typing import Any

VOLATILE = frozenset(
    ("cpu_s", "seconds", "seconds_per_step", "examples_per_s", "commit", "machine", "created",
     "time", "ended", "sha256", "perception_s", "planning_s", "acting_s")
)  # fmt: skip
"""Keys of JSON documents that are left out."""

TIMES = ("predict_s", "align_s", "correct_s")
"""Arrays of a tracked trajectory that are left out."""

PROGRESS = re.compile(r"events\.out\.tfevents|progress\.pt$|\.jsonl$")
"""Files of a training that are its memory and no result."""


def contents(folder: Path) -> dict[str, str]:
    """Return the digests of all results in a folder, by their names; what is hidden is none."""
    if folder.is_file():
        return {folder.name: digest(folder)}
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in name.parts)
        if hidden or path.is_dir() or PROGRESS.search(path.name) or set(name.parts) & set(TIMES):
            continue
        found[name.as_posix()] = digest(path)
    return found


def digest(path: Path) -> str:
    """SHA-256 of what two runs share of a file."""
    data = path.read_bytes()
    if path.suffix == ".json":
        data = _plain(data)
    elif path.suffix == ".npz":
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            parts = {name: archive.read(name) for name in sorted(archive.namelist())}
        parts.pop("sha256.npy", None)
        data = b"".join(name.encode() + _text(part) for name, part in parts.items())
    elif path.suffix == ".safetensors":
        size = 8 + int.from_bytes(data[:8], "little")
        data = _plain(data[8:size]) + data[size:]
    elif path.suffix in (".html", ".md"):
        data = re.sub(rb"\d[\d.,]* ?(m?s|min|states per CPU-hour)\b|commit: \S+", b"", data)
    return hashlib.sha256(data).hexdigest()


def hidden_in(folder: Path) -> list[str]:
    """Return hidden files other than the measures that `evaluate` keeps."""
    found = [path for path in folder.rglob(".*") if path.suffix != ".measured"]
    return sorted(str(path.relative_to(folder)) for path in found)


def _text(array: bytes) -> bytes:
    """Return a NumPy array with a JSON document without values that may differ; others as is."""
    import numpy as np

    values = np.load(io.BytesIO(array), allow_pickle=False)
    text = str(values) if values.dtype.kind == "U" and not values.ndim else ""
    return _plain(text.encode()) if text.startswith("{") else array


def _plain(document: bytes) -> bytes:
    try:
        return json.dumps(_shared(json.loads(document)), sort_keys=True).encode()
    except ValueError:
        return document


def _shared(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _shared(one) for key, one in value.items() if key not in VOLATILE}
    if isinstance(value, list):
        return [_shared(one) for one in value]
    if isinstance(value, str) and value.startswith("{"):
        try:
            return _shared(json.loads(value))
        except ValueError:
            return value
    return value
