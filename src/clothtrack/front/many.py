"""Label and evaluate many tracked trajectories, in several processes and on several machines."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation.label_review import review_path
from clothtrack.evaluation.results import Evaluation, as_plain, from_plain
from clothtrack.files.atomic_write import content_hash, write_file
from clothtrack.files.progress import Progress
from clothtrack.files.shared_work import Executor, Share, attempts, results_of
from clothtrack.files.work_folder import WorkFolder
from clothtrack.files.worker_pool import finished_in_workers
from clothtrack.front.learning import label
from clothtrack.front.run import Run, evaluate, recording_of
from clothtrack.recordings.identity import recording_digest
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.artefacts import inside, load_tracked, recording_folder, warn_of_age
from clothtrack.version import __version__


def label_many(
    tracked: Sequence[Path],
    recordings: Path,
    output: Path,
    options: Mapping[str, Any],
    *,
    workers: int = 1,
    share: Share | None = None,
    progress: Progress | None = None,
    executor: Executor = finished_in_workers,
) -> list[Path]:
    """Write the pseudo-labels of many runs; those that are there from the same input are kept.

    Args:
        tracked: NAME.zarr folders.
        recordings: the recording, or the folder in which recordings lie by name.
        output: folder for NAME.labels.npz.
        options: of `label`.
        workers: processes.
        share: which of the runs are this process's; all by default.
        progress: called first, and after each run.
        executor: who runs the work; worker processes by default.

    Returns:
        The files of the share, in the order of the runs.

    Raises:
        InvalidConfigError: two runs have one name.
        ClothTrackError: a run cannot be labelled; after all others.
    """
    work = _Labelling(_Source(recordings, _without_twins(tracked), dict(options)), output)
    shared = attempts(
        work, tracked, WorkFolder(output, "label"), kind="trajectories", processes=workers,
        share=share, progress=progress, executor=executor,
    )  # fmt: skip
    with closing(shared) as tries:
        files = dict(results_of(tries))
    return [files[path] for path in (share or Share()).of(tracked)]


def evaluate_many(
    tracked: Sequence[Path],
    recordings: Path,
    output: Path | None,
    options: Mapping[str, Any],
    *,
    workers: int = 1,
    share: Share | None = None,
    progress: Progress | None = None,
    executor: Executor = finished_in_workers,
) -> list[Evaluation]:
    """Measure many runs; with an output, what others have measured for it is kept.

    Args:
        tracked: NAME.zarr folders.
        recordings: the recording, or the folder in which recordings lie by name.
        output: JSON file for all measures; what each share has measured is added to it.
        options: of `evaluate`.
        workers: processes.
        share: which of the runs are this process's; all by default.
        progress: called first, and after each run.
        executor: who runs the work; worker processes by default.

    Returns:
        The measures of the share, in the order of the runs.

    Raises:
        ClothTrackError: a run cannot be measured; after all others.
    """
    share = share or Share()
    source = _Source(recordings, tuple(tracked), dict(options))
    if output is None:
        mine = share.of(tracked)
        with closing(executor(source.evaluation, mine, workers)) as results:
            measured = dict(results)
        return [measured[path] for path in mine]
    folder = WorkFolder(output.parent, "evaluate")
    work = _Measuring(source, folder.folder / "measured" / output.name)
    shared = attempts(
        work, tracked, folder, kind="trajectories", processes=workers, share=share,
        progress=progress, executor=executor,
    )  # fmt: skip
    with closing(shared) as tries:
        measured = dict(results_of(tries))
    with folder.locked(output.name):
        found = [measured.get(path) or work.kept(path) for path in tracked]
        rows = [as_plain(one) for one in found if one is not None]
        write_file(output, (json.dumps(rows, indent=2, allow_nan=False) + "\n").encode())
    return [measured[path] for path in share.of(tracked)]


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

    def evaluation(self, path: Path) -> tuple[Path, Evaluation]:
        """Measure a run."""
        run = self.run(path)
        found = evaluate(run, **self.options)
        self.tell(path, run)
        return path, found


@dataclass(frozen=True)
class _Labelling:
    """Label a run, as `clothtrack.files.shared_work.Work`."""

    source: _Source
    output: Path

    def name(self, path: Path) -> str:
        """The name of the run."""
        return path.stem

    def paths(self, path: Path) -> list[Path]:
        """The note of what the labels are from, and the labels."""
        folder = WorkFolder(self.output, "label").folder
        return [folder / "from" / f"{path.stem}.txt", self.output / f"{path.stem}.labels.npz"]

    def kept(self, path: Path) -> Path | None:
        """Labels that were made before, from the same files and options, and are as they were."""
        note, file = self.paths(path)
        if not (note.is_file() and file.is_file()):
            return None
        if note.read_text("ascii") != f"{self.source.digest(path)} {content_hash(file)}":
            return None
        self.source.tell(path, self.source.run(path))
        return file

    def do(self, path: Path) -> Path:
        """Label it."""
        digest, (note, file) = self.source.digest(path), self.paths(path)
        run = self.source.run(path)
        label(run, file, **self.source.options)
        write_file(note, f"{digest} {content_hash(file)}".encode())
        self.source.tell(path, run)
        return file


@dataclass(frozen=True)
class _Measuring:
    """Measure a run, as `clothtrack.files.shared_work.Work`."""

    source: _Source
    folder: Path

    def name(self, path: Path) -> str:
        """The name of the run."""
        return self.source.name(path)

    def paths(self, path: Path) -> list[Path]:
        """The measures of this run alone."""
        return [self.folder / f"{self.name(path)}.json"]

    def kept(self, path: Path) -> Evaluation | None:
        """What was measured before, of the same files with the same options."""
        (file,) = self.paths(path)
        if not file.is_file():
            return None
        try:
            document = json.loads(file.read_text("utf-8"))
            if document["digest"] != self.source.digest(path):
                return None
            found = from_plain(document["evaluation"])
        except (ValueError, KeyError, TypeError, RecursionError):
            return None
        self.source.tell(path, self.source.run(path))
        return found

    def do(self, path: Path) -> Evaluation:
        """Measure it."""
        digest, (file,) = self.source.digest(path), self.paths(path)
        run = self.source.run(path)
        found = evaluate(run, **self.source.options)
        document = {"digest": digest, "evaluation": as_plain(found)}
        write_file(file, json.dumps(document, allow_nan=False).encode())
        self.source.tell(path, run)
        return found
