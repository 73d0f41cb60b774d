"""The work per item for many tracked trajectories: labeling and measuring."""

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clothtrack.api.learning import label
from clothtrack.api.run import Run, evaluate, load, recording_of
from clothtrack.errors import InvalidResultError
from clothtrack.evaluation.label_review import review_path
from clothtrack.evaluation.results import Evaluation, as_plain, from_plain
from clothtrack.files.atomic_write import content_hash, write_file
from clothtrack.recordings.identity import array_digest, recording_digest
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.artifacts import (
    inside,
    load_tracked,
    recording_folder,
    require_own,
    warn_of_age,
)
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory
from clothtrack.version import __version__

_MADE_FROM = "made_from_sha256"
"""Field of the labels' provenance: digest of all that they depend on."""


@dataclass(frozen=True)
class Source:
    """Runs with their recordings, and the options of the work."""

    recordings: Path | None
    tracked: tuple[Path, ...]
    options: Mapping[str, Any] = field(default_factory=dict)

    def name(self, path: Path) -> str:
        """Return the name of a run, with its place in the list if several have the name."""
        same = [one for one in self.tracked if one.stem == path.stem]
        return path.stem if len(same) == 1 else f"{path.stem}_{same.index(path)}"

    def digest(self, path: Path) -> str:
        """Return the SHA-256 over everything that the result of a run depends on."""
        tracked = load_tracked(path)
        recording = self._recording(tracked, path)
        files = [path / "zarr.json", review_path(path)]
        if truth := self.options.get("truth"):
            files.append(inside(Path(truth), f"{tracked.name}.npz"))
        parts = [__version__, json.dumps(self.options, sort_keys=True, default=str)]
        parts += [content_hash(file) if file.is_file() else "" for file in files]
        parts.append(array_digest(tracked.positions))
        return hashlib.sha256("\n".join([*parts, recording_digest(recording)]).encode()).hexdigest()

    def run(self, path: Path) -> Run:
        """Return a run with its recording, even if that has changed since."""
        tracked = load_tracked(path)
        return Run.of(tracked, self._recording(tracked, path), path)

    def _recording(self, tracked: TrackedTrajectory, path: Path) -> Recording:
        """Return the recording from the given folder, or else the one that `load` finds."""
        if self.recordings is not None:
            folder = recording_folder(tracked, self.recordings)
            recording = read_recording(folder)
            require_own(tracked, recording, artifact=path, folder=folder)
            return recording
        return recording_of(load(path))

    def tell(self, path: Path, run: Run) -> None:
        """Warn if the recording has changed; call it after the work, as an error is one line."""
        source = recording_of(run)
        warn_of_age(run, source, artifact=path, folder=source.folder)


@dataclass(frozen=True)
class Labeling:
    """The labeling of runs, a `clothtrack.files.many_items.Work`."""

    source: Source
    output: Path

    def name(self, path: Path) -> str:
        """Return the name of the run."""
        return path.stem

    def paths(self, path: Path) -> list[Path]:
        """Return the path of the labels."""
        return [self.output / f"{path.stem}.labels.npz"]

    def kept(self, path: Path) -> Path | None:
        """Return labels that were made before from the same files and options, or None."""
        (file,) = self.paths(path)
        if not file.is_file():
            return None
        from clothtrack.reconstruction.data.pseudo_labels import read_labels

        try:
            made_from = read_labels(file).provenance.get(_MADE_FROM)
        except InvalidResultError:
            return None
        if made_from != self.source.digest(path):
            return None
        self.source.tell(path, self.source.run(path))
        return file

    def do(self, path: Path) -> Path:
        """Label the run."""
        (file,), made_from = self.paths(path), {_MADE_FROM: self.source.digest(path)}
        run = self.source.run(path)
        label(run, file, **self.source.options, provenance=made_from)
        self.source.tell(path, run)
        return file


@dataclass(frozen=True)
class Measuring:
    """The measuring of runs, a `clothtrack.files.many_items.Work`."""

    source: Source
    folder: Path | None

    def name(self, path: Path) -> str:
        """Return the name of the run."""
        return self.source.name(path)

    def paths(self, path: Path) -> list[Path]:
        """Return the path of the measures of this run alone, if they are written."""
        return [] if self.folder is None else [self.folder / f"{self.name(path)}.json"]

    def kept(self, path: Path) -> Evaluation | None:
        """Return measures that were made before from the same files and options, or None."""
        for file in self.paths(path):
            with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
                document = json.loads(file.read_text("utf-8"))
                if document["digest"] == self.source.digest(path):
                    found = from_plain(document["evaluation"])
                    self.source.tell(path, self.source.run(path))
                    return found
        return None

    def do(self, path: Path) -> Evaluation:
        """Measure the run."""
        digest, run = self.source.digest(path), self.source.run(path)
        found = evaluate(run, **self.source.options)
        for file in self.paths(path):
            document = {"digest": digest, "evaluation": as_plain(found)}
            write_file(file, json.dumps(document, allow_nan=False).encode())
        self.source.tell(path, run)
        return found
