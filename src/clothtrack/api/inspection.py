"""Inspection of artifacts: whether they are readable, and what is wrong."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from clothtrack.api.results import Many
from clothtrack.errors import InvalidConfigError
from clothtrack.recordings.violation import DOCUMENT

if TYPE_CHECKING:
    from clothtrack.api.verification import Verification
    from clothtrack.files.progress import Progress
    from clothtrack.recordings.inspection import Inspection


def inspect_many(
    artifacts: Sequence[Path | str],
    *,
    progress: "Progress | None" = None,
) -> "Many[Inspection | Verification]":
    """Check that artifacts can be read to their ends, and list what is wrong.

    For a recording, report what it holds, what is wrong, and which of its geometry its own pictures
    contradict. For everything else, report one line: ok, or what is damaged. The exit code is 1 if
    something is wrong.

    Args:
        artifacts: recordings, NAME.zarr that `track` wrote, labels and truth (.npz), weights
            (.safetensors), folders of states or of the benchmark.
        progress: called with how much is done.

    Raises:
        InvalidConfigError: an artifact is a folder of results.
    """
    from clothtrack.api.verification import verify
    from clothtrack.files.progress import one_of
    from clothtrack.recordings.inspection import inspect

    for folder in map(Path, artifacts):
        if held := _results_in(folder):
            raise InvalidConfigError(f"{folder}: is a folder of results; name them: {held}")
    found = []
    for done, artifact in enumerate(map(Path, artifacts)):
        if _is_recording(artifact):
            found.append(inspect(artifact))
        else:
            of_all = one_of(progress, done, len(artifacts))
            found.append(verify(artifact, progress=of_all))
    return Many(tuple(found))


def _results_in(folder: Path) -> Path | None:
    """Return a pattern for the results in a folder that is no artifact itself."""
    try:
        if (folder / DOCUMENT).exists():
            return None
        return next((folder / one for one in ("*.zarr", "*.npz") if any(folder.glob(one))), None)
    except OSError:
        # Its reader reports the error.
        return None


def _is_recording(path: Path) -> bool:
    """Return whether it is a recording; a folder that shows no sign of its kind counts as one."""
    if path.suffix in (".zarr", ".npz", ".safetensors"):
        return False
    try:
        return not any(one.is_file() for one in (path, path / "bench.json", path / "states.json"))
    except OSError:
        # Its reader reports the error.
        return True
