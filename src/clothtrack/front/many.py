"""Label and evaluate many tracked trajectories, in several processes or by Ray."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.evaluation.label_review import review_path
from clothtrack.evaluation.results import Evaluation, as_plain, from_plain
from clothtrack.files.atomic_write import content_hash, write_file
from clothtrack.files.many_items import attempts, results_of
from clothtrack.files.output_lock import locked_output
from clothtrack.files.progress import Progress
from clothtrack.front.learning import label
from clothtrack.front.run import Run, evaluate, recording_of
from clothtrack.recordings.identity import recording_digest
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.artefacts import inside, load_tracked, recording_folder, warn_of_age
from clothtrack.version import __version__

MADE_FROM = "made_from_sha256"
"""Field of the labels' provenance: digest of all that they depend on."""


def label_many(
    tracked: Sequence[Path],
    recordings: Path,
    output: Path,
    options: Mapping[str, Any],
    *,
    workers: int = 1,
    ray: str = "",
    progress: Progress | None = None,
) -> list[Path]:
    """Write the pseudo-labels of many runs; those that are there from the same input are kept.

    Args:
        tracked: NAME.zarr folders.
        recordings: the recording, or the folder in which recordings lie by name.
        output: folder for NAME.labels.npz.
        options: of `label`.
        workers: processes.
        ray: address of Ray, which is to do it; worker processes by default.
        progress: called first, and after each run.

    Returns:
        The files, in the order of the runs.

    Raises:
        InvalidConfigError: two runs have one name, or another run writes to `output`.
        ClothTrackError: a run cannot be labelled, after all others; or a worker died.
    """
    work = _Labelling(_Source(recordings, _without_twins(tracked), dict(options)), output)
    labelled = attempts(
        work, tracked, kind="trajectories", workers=workers, ray=ray, device=options["device"],
        progress=progress,
    )  # fmt: skip
    with locked_output(output), closing(labelled) as tries:
        files = dict(results_of(tries))
    return [files[path] for path in tracked]


def evaluate_many(
    tracked: Sequence[Path],
    recordings: Path,
    output: Path | None,
    options: Mapping[str, Any],
    *,
    workers: int = 1,
    ray: str = "",
    progress: Progress | None = None,
) -> list[Evaluation]:
    """Measure many runs; with an output, what was measured for it before is kept.

    Args:
        tracked: NAME.zarr folders.
        recordings: the recording, or the folder in which recordings lie by name.
        output: JSON file for all measures. Beside it, a hidden folder keeps those of each run.
        options: of `evaluate`.
        workers: processes.
        ray: address of Ray, which is to do it; worker processes by default.
        progress: called first, and after each run.

    Returns:
        The measures, in the order of the runs.

    Raises:
        InvalidConfigError: another run writes to `output`.
        ClothTrackError: a run cannot be measured, after all others; or a worker died.
    """
    source = _Source(recordings, tuple(tracked), dict(options))
    folder = None if output is None else output.with_name(f".{output.name}.measured")
    measuring = attempts(
        _Measuring(source, folder), tracked, kind="trajectories", workers=workers, ray=ray,
        device=options["device"], progress=progress,
    )  # fmt: skip
    with nullcontext() if folder is None else locked_output(folder), closing(measuring) as tries:
        measured = dict(results_of(tries))
        found = [measured[path] for path in tracked]
        if output is not None:
            rows = [as_plain(one) for one in found]
            write_file(output, (json.dumps(rows, indent=2, allow_nan=False) + "\n").encode())
    return found


def _without_twins(tracked: Sequence[Path]) -> tuple[Path, ...]:
    names = [path.stem for path in tracked]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InvalidConfigError(
            f"two trajectories are called {min(twice)!r}, their labels would overwrite each "
            "other; give each a folder of its own with --output"
        )
    return tuple(tracked)


@dataclass(frozen=True)
class _Source:
    """Runs with their recordings, and what is asked of them."""

    recordings: Path
    tracked: tuple[Path, ...]
    options: Mapping[str, Any] = field(default_factory=dict)

    def name(self, path: Path) -> str:
        """The name of a run, with its place in the list where several have it."""
        same = [one for one in self.tracked if one.stem == path.stem]
        return path.stem if len(same) == 1 else f"{path.stem}_{same.index(path)}"

    def digest(self, path: Path) -> str:
        """SHA-256 over all that the result of a run depends on."""
        tracked = load_tracked(path)
        recording = read_recording(recording_folder(tracked, self.recordings))
        files = [path / "zarr.json", review_path(path)]
        if truth := self.options.get("truth"):
            files.append(inside(Path(truth), f"{tracked.name}.npz"))
        parts = [__version__, json.dumps(self.options, sort_keys=True, default=str)]
        parts += [content_hash(file) if file.is_file() else "" for file in files]
        return hashlib.sha256("\n".join([*parts, recording_digest(recording)]).encode()).hexdigest()

    def run(self, path: Path) -> Run:
        """A run with its recording, whether or not that has changed since."""
        tracked = load_tracked(path)
        return Run.of(tracked, read_recording(recording_folder(tracked, self.recordings)), path)

    def tell(self, path: Path, run: Run) -> None:
        """Warn when the recording has changed since; afterwards, as a refusal is one line."""
        folder = recording_folder(run, self.recordings)
        warn_of_age(run, recording_of(run), artefact=path, folder=folder)


@dataclass(frozen=True)
class _Labelling:
    """Label a run, as `clothtrack.files.many_items.Work`."""

    source: _Source
    output: Path

    def name(self, path: Path) -> str:
        """The name of the run."""
        return path.stem

    def paths(self, path: Path) -> list[Path]:
        """The labels."""
        return [self.output / f"{path.stem}.labels.npz"]

    def kept(self, path: Path) -> Path | None:
        """Labels that were made before, from the same files and options."""
        (file,) = self.paths(path)
        if not file.is_file():
            return None
        from clothtrack.reconstruction.data.pseudo_labels import read_labels

        try:
            made_from = read_labels(file).provenance.get(MADE_FROM)
        except InvalidResultError:
            return None
        if made_from != self.source.digest(path):
            return None
        self.source.tell(path, self.source.run(path))
        return file

    def do(self, path: Path) -> Path:
        """Label it."""
        (file,), made_from = self.paths(path), {MADE_FROM: self.source.digest(path)}
        run = self.source.run(path)
        label(run, file, **self.source.options, provenance=made_from)
        self.source.tell(path, run)
        return file


@dataclass(frozen=True)
class _Measuring:
    """Measure a run, as `clothtrack.files.many_items.Work`."""

    source: _Source
    folder: Path | None

    def name(self, path: Path) -> str:
        """The name of the run."""
        return self.source.name(path)

    def paths(self, path: Path) -> list[Path]:
        """The measures of this run alone, if they are written."""
        return [] if self.folder is None else [self.folder / f"{self.name(path)}.json"]

    def kept(self, path: Path) -> Evaluation | None:
        """What was measured before, of the same files with the same options."""
        for file in self.paths(path):
            with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
                document = json.loads(file.read_text("utf-8"))
                if document["digest"] == self.source.digest(path):
                    found = from_plain(document["evaluation"])
                    self.source.tell(path, self.source.run(path))
                    return found
        return None

    def do(self, path: Path) -> Evaluation:
        """Measure it."""
        digest, run = self.source.digest(path), self.source.run(path)
        found = evaluate(run, **self.source.options)
        for file in self.paths(path):
            document = {"digest": digest, "evaluation": as_plain(found)}
            write_file(file, json.dumps(document, allow_nan=False).encode())
        self.source.tell(path, run)
        return found
