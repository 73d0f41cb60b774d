"""Check that artifacts of every kind are unchanged; the content tells the kind."""

import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from clothtrack.api.learning_extra import require_learning
from clothtrack.errors import ClothTrackError, InvalidConfigError, InvalidResultError
from clothtrack.evaluation.truth import Truth
from clothtrack.files.progress import Progress
from clothtrack.geometry.devices import quiet_warp
from clothtrack.recordings.validation import check_recording
from clothtrack.recordings.violation import DOCUMENT, grouped
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

_VERIFIED = (
    "inspect takes a recording, NAME.zarr that `track` wrote, labels or truth (.npz), weights "
    "(.safetensors), or a folder of states or of the benchmark"
)
_LISTED = 3


@dataclass(frozen=True)
class Verification:
    """The result of checking one artifact.

    Attributes:
        path: its path.
        kind: kind of artifact; empty if unknown.
        problems: what is wrong with it; empty if nothing is.
        notes: what was checked, what it holds.
    """

    path: Path
    kind: str
    problems: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.problems

    def text(self) -> str:
        """Return the same as `str`."""
        return str(self)

    def as_dict(self) -> dict[str, Any]:
        """Return the same as JSON-compatible values."""
        return {**asdict(self), "path": str(self.path), "ok": self.ok}

    def __str__(self) -> str:
        """Return one line: the path; ok, damaged or not known; and what was found."""
        if self.ok:
            return f"{self.path}   ok: {', '.join([self.kind, *self.notes])}"
        more = len(self.problems) - _LISTED
        said = "; ".join(self.problems[:_LISTED]) + (f" (and {more} more)" if more > 0 else "")
        return f"{self.path}   {'damaged' if self.kind else 'not known'}: {said}"


def verify(artifact: Path | str, *, progress: Progress | None = None) -> Verification:
    """Check that one artifact can be read to its end.

    Every picture of a recording is decoded; the checksums of PNG, Zarr and ZIP refuse damage.

    Args:
        artifact: a recording, NAME.zarr, labels or truth (.npz), weights (.safetensors), or a
            folder of states or of the benchmark.
        progress: called with how much is done.
    """
    path = Path(artifact)
    quiet_warp()
    kind = ""
    try:
        kind, check = _kind_of(path)
        return Verification(path, kind, *check(path, progress))
    except (ClothTrackError, OSError) as error:
        text = str(error).removeprefix(f"{path}: ").removeprefix(f"{path} ")
        return Verification(path, kind, (text,))


_Findings = tuple[tuple[str, ...], tuple[str, ...]]
"""Problems and notes."""

Check = Callable[[Path, Progress | None], _Findings]


def _kind_of(path: Path) -> tuple[str, Check]:
    """Return the kind of an artifact and the function that checks it."""
    for name, kind, check in (
        (DOCUMENT, "recording", _recording),
        ("bench.json", "benchmark", _bench),
        ("states.json", "states", _states),
    ):
        if (path / name).is_file():
            return kind, check
    if path.suffix == ".zarr" and path.is_dir():
        return ("shard of states", _shard) if _is_shard(path) else ("tracked trajectory", _tracked)
    if path.suffix == ".safetensors":
        return "weights", _weights
    if path.suffix == ".npz":
        return ("labels", _labels) if "document" in _names_in(path) else ("truth", _truth)
    if not path.exists():
        raise InvalidConfigError(f"{path}: there is no such file or folder; {_VERIFIED}")
    raise InvalidConfigError(f"{path}: nothing that can be told by its content; {_VERIFIED}")


def _is_shard(path: Path) -> bool:
    try:
        document = json.loads((path / "zarr.json").read_bytes())
        return document["attributes"]["format"] == "clothtrack-states"
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return path.parent.name == "shards"


def _names_in(path: Path) -> set[str]:
    """Return the names of the arrays of an NPZ file."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {name.removesuffix(".npy") for name in archive.namelist()}
    except FileNotFoundError as error:
        raise InvalidConfigError(f"{path}: there is no such file; {_VERIFIED}") from error
    except (zipfile.BadZipFile, ValueError, NotImplementedError):
        # Its reader reports what is wrong.
        return {"document"} if path.name.endswith(".labels.npz") else set()


def _recording(path: Path, progress: Progress | None) -> _Findings:
    del progress
    checked = check_recording(path, thorough=True)
    if checked.recording is None:
        return tuple(grouped(checked.violations)), ()
    recording = checked.recording
    counts = _count(len(recording.frames), "frame"), _count(len(recording.actions), "action")
    return (), (*counts, "every picture decoded")


def _tracked(path: Path, progress: Progress | None) -> _Findings:
    del progress
    return (), (_counts(TrackedTrajectory.load(path)),)


def _counts(tracked: TrackedTrajectory) -> str:
    frames, vertices = tracked.positions.shape[:2]
    return (
        f"{_count(frames, 'frame')}, {vertices} vertices, {_count(len(tracked.actions), 'action')}"
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _labels(path: Path, progress: Progress | None) -> _Findings:
    del progress
    require_learning()
    from clothtrack.reconstruction.data.pseudo_labels import read_labels

    labels = read_labels(path)
    return (), (f"{_count(len(labels.pictures), 'label')} of {labels.name:.80}",)


def _truth(path: Path, progress: Progress | None) -> _Findings:
    del progress
    truth = Truth.load(path)
    return (), (f"{_count(len(truth.frames), 'frame')}, {truth.positions.shape[1]} vertices",)


def _weights(path: Path, progress: Progress | None) -> _Findings:
    del progress
    require_learning()
    from clothtrack.reconstruction.training.checkpoint import load_weights

    weights = load_weights(path)
    for name, values in weights.tensors.items():
        if values.is_floating_point() and not bool(values.isfinite().all()):
            raise InvalidResultError(f"{name} is not finite; fetch an undamaged copy")
    return (), (f"{len(weights.tensors)} arrays for {weights.kind:.80}",)


def _states(path: Path, progress: Progress | None) -> _Findings:
    from clothtrack.reconstruction.data.state_store import SHARD_FOLDER, open_states, read_shard

    found = open_states(path)
    listed: Any = found.document.get("shards", {})
    names = {shard.name for shard in found.shards}
    listed = set(listed) if isinstance(listed, Mapping) else set()
    problems = [f"{SHARD_FOLDER}/{name} is missing" for name in sorted(listed - names)]
    states = 0
    for done, shard in enumerate(found.shards):
        if progress is not None:
            progress(f"{shard.name}, {done + 1}/{len(found.shards)}", done, len(found.shards))
        try:
            states += len(read_shard(shard).positions)
        except ClothTrackError as error:
            problems.append(str(error).removeprefix(f"{path}/"))
    return tuple(problems), (f"{_count(len(found.shards), 'garment')}, {states} states",)


def _shard(path: Path, progress: Progress | None) -> _Findings:
    del progress
    from clothtrack.reconstruction.data.state_store import read_shard

    return (), (f"{len(read_shard(path).positions)} states",)


def _bench(path: Path, progress: Progress | None) -> _Findings:
    try:
        listed = json.loads((path / "bench.json").read_bytes())["trajectories"]
        names = [str(one["name"]) for one in listed]
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        text = f"bench.json: not a list of trajectories ({error}); unpack it again"
        raise InvalidResultError(text) from error
    problems = []
    for done, name in enumerate(names):
        if progress is not None:
            progress(f"{name}, {done + 1}/{len(names)}", done, len(names))
        for part in (path / "recordings" / name, path / "truth" / f"{name}.npz"):
            problems += [f"{name}: {problem}" for problem in verify(part).problems]
    return tuple(problems), (_count(len(names), "recording"), "each with its truth")
