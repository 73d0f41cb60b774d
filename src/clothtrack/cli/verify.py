"""The verb that checks whether what lies on a disk is still what was written: verify."""

import json as json_module
from dataclasses import asdict
from pathlib import Path

from tyro.conf import Positional

import clothtrack as ct
from clothtrack.cli.options import AsJson
from clothtrack.cli.terminal import complain, progress, say
from clothtrack.files.progress import one_of


def verify(
    artefacts: Positional[tuple[Path, ...]],
    *,
    recordings: Path | None = None,
    json: AsJson = False,
) -> int:
    """Is it still what was written? One line for each: ok, or what is damaged.

    Checksums are compared where there are some, and everything is read. With --recordings the first
    action of a tracked trajectory is tracked again and compared to the bit; a line says so where
    that cannot be done, as with another version or on another machine. Exit code 1: damage.

    Args:
        artefacts: recordings, NAME.zarr that `track` wrote, labels and truth (.npz), weights
            (.safetensors), folders of states or of the benchmark.
        recordings: the recording, or the folder in which recordings lie by name.
        json: machine-readable.
    """
    if not artefacts:
        complain("nothing to verify; name at least one file or folder")
        return 2
    found = []
    for done, path in enumerate(artefacts):
        of_all = one_of(progress, done, len(artefacts))
        found.append(ct.verify(path, recordings, progress=of_all))
        if not json:
            say(str(found[-1]))
    if json:
        rows = [{**asdict(one), "path": str(one.path), "ok": one.ok} for one in found]
        say(json_module.dumps(rows, indent=2))
    return 0 if all(one.ok for one in found) else 1
