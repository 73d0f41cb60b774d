"""Track a recording, load a run, and evaluate it."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack._shown import html_table, short_repr
from clothtrack.errors import (
    ClothTrackError,
    InvalidConfigError,
    InvalidRecordingError,
)
from clothtrack.evaluation import results
from clothtrack.evaluation.label_quality import (
    INTERVAL_FACTOR,
    LabelQuality,
    expected_vertex_errors,
    judge_labels,
)
from clothtrack.evaluation.truth import Truth
from clothtrack.evaluation.verdict import Verdict, judged, verdict_of
from clothtrack.files.settings import with_settings
from clothtrack.geometry.devices import quiet_warp, require_device
from clothtrack.recordings.identity import DIGEST_FIELD, recording_digest
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.artifacts import (
    inside,
    load_tracked,
    recording_folder,
    require_own,
    warn_of_age,
)
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.configuration import mode as settings_of_mode
from clothtrack.tracking.pipeline import Progress, track_recording
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory


@dataclass(frozen=True, eq=False)
class Label:
    """The mesh at the end of an action, and how far it can be trusted.

    Attributes:
        action: number of the action, from 0.
        frame: frame of the recording.
        positions: vertices after the final alignment [m].
        expected_error_mm: expected mean vertex error [mm]; NaN if nothing was observed.
        vertex_errors_m: expected error of each vertex [m], larger where the mesh contradicts the
            observation.
        vertex_bounds_m: the error that 90 % of the vertices stay under [m], for each vertex.
    """

    action: int
    frame: int
    positions: Float[np.ndarray, "vertices 3"]
    expected_error_mm: float
    vertex_errors_m: Float[np.ndarray, " vertices"]

    __repr__ = short_repr

    @property
    def vertex_bounds_m(self) -> Float[np.ndarray, " vertices"]:
        """The error that 90 % of the vertices stay under [m], for each vertex."""
        return INTERVAL_FACTOR * self.vertex_errors_m


@dataclass(frozen=True, eq=False)
class Run(TrackedTrajectory):
    """A tracked trajectory with the recording that it was tracked from.

    It can be used as any `TrackedTrajectory`. These are its main attributes; docs/result_format.md
    has them all.

    Attributes:
        positions: vertex positions in the world [m], (frames, vertices, 3).
        visible: whether some camera sees the vertex, (frames, vertices).
        mesh: topology, rest shape and canonical coordinates.
        actions: what was found for each pick-and-place: parameters, calibration, held vertices.
        config: every setting of the run.
        provenance: versions, commit, seed, device, and the recording's own provenance.
        recording: the tracked recording; None if it was not found.
        segmenter: the segmenter that the caller gave, if any; it is not stored.
        path: NAME.zarr, where it was saved last or read from; None if it was neither.
    """

    recording: Recording | None = None
    segmenter: Segmenter | None = None
    path: Path | None = field(default=None, init=False)

    __repr__ = TrackedTrajectory.__repr__

    def _repr_html_(self) -> str:
        frames, vertices = self.positions.shape[:2]
        stored = Verdict.from_dict(self.verdict_fields) if self.verdict_fields else "not judged yet"
        rows = {
            "frames": f"{frames} in {self.time_s[-1] - self.time_s[0]:.2f} s",
            "vertices": vertices,
            "mode": self.config["mode"],
            "verdict": stored,
        }
        for number, action in enumerate(self.actions):
            rows[f"action {number}"] = f"frames {action.first_frame} to {action.last_frame}"
        return html_table(f"Run {self.name}", rows)

    @classmethod
    def of(
        cls, tracked: TrackedTrajectory, recording: Recording | None, path: Path | None = None
    ) -> "Run":
        """Return the trajectory with its recording and its path on disk."""
        values = {field.name: getattr(tracked, field.name) for field in fields(TrackedTrajectory)}
        run = cls(**values, recording=recording)
        if path is not None:
            run._lies_at(path)
        return run

    @classmethod
    def load(cls, path: Path | str, recording: Recording | Path | str | None = None) -> "Run":
        """Read a run; the same as `load`."""
        return load(path, recording)

    def save(self, path: Path | str) -> None:
        """Write NAME.zarr, whole or not at all; decisions about labels go beside it.

        Raises:
            StorageError: when the disk refuses; nothing is left under `path` then.
        """
        super().save(path)
        self._lies_at(Path(path))

    def _lies_at(self, path: Path) -> None:
        # Only the path of a run ever changes; the values of the trajectory stay as they are.
        object.__setattr__(self, "path", path)

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """The mesh at the end of each action, judged by the observation.

        Raises:
            InvalidRecordingError: the recording is not known.
        """
        return tuple(
            Label(
                judged.action,
                judged.frame,
                action.positions_after_final_alignment,
                judged.expected_error_mm,
                expected_vertex_errors(action, judged),
            )
            for judged, action in zip(self._judged, self.actions, strict=True)
        )

    @property
    def verdict(self) -> Verdict:
        """Trust, look or reject, with the reason and all evidence.

        It is the verdict stored with the trajectory, or a new one for a trajectory that was tracked
        before verdicts were stored.

        Raises:
            InvalidRecordingError: the recording is not known.
        """
        return verdict_of(self, recording_of(self))

    @cached_property
    def _judged(self) -> tuple[LabelQuality, ...]:
        return judge_labels(self, recording_of(self), segmenter=self.segmenter)


def track(
    recording: Recording | Path | str,
    config: RunConfig | None = None,
    *,
    mode: str = "default",
    settings: Sequence[str] = (),
    device: str = "cpu",
    segmenter: Segmenter | None = None,
    progress: Progress | None = None,
    force: bool = False,
    **parts: Any,
) -> Run:
    """Track a recording: the full mesh, hidden layers included, at every frame (Algorithm 1).

    Args:
        recording: a folder with recording.json, or a `Recording`.
        config: the whole configuration; that of `mode` by default.
        mode: one of `MODES`: our default, the paper's method, or the dynamics alone.
        settings: changes to the configuration, such as "search.method=none".
        device: "cpu" or "cuda:0".
        segmenter: finds the cloth in a picture; the recording's masks or colors by default.
        progress: called after every frame with a description of the step, the amount of work done,
            and the total.
        force: track although the first mesh lies more than 2 cm (rms) from its cloud, or times are
            not in seconds.
        **parts: replacements for functions of Algorithm 1 (`clothtrack.tracking.Method`): observe,
            calibrate, dynamics, align, line_search, align_last, anchor, at_rest.

    Raises:
        InvalidRecordingError: the recording cannot be used; or, without `force`, the first mesh is
            not on its cloud or times are not in seconds.
        InvalidConfigError: unknown mode, setting, part or device; or both a config and a mode.
    """
    quiet_warp()
    require_device(device)
    if config is not None and mode != "default":
        raise InvalidConfigError(
            f"both a config and mode={mode!r} were given; leave one out, or give mode({mode!r})"
        )
    whole = with_settings(config, settings) if config else run_config(mode, settings)
    source = _read(recording)
    tracked = track_recording(
        source, whole, device=device, segmenter=segmenter, progress=progress, parts=parts,
        force=force, judge=judged,
    )  # fmt: skip
    return replace(Run.of(tracked, source), segmenter=segmenter)


def run_config(mode: str = "default", settings: Sequence[str] = (), *, seed: int = 0) -> RunConfig:
    """Return the configuration of a mode with some settings changed.

    Raises:
        InvalidConfigError: unknown mode or setting, or a setting that changes the mode.
    """
    config = with_settings(replace(settings_of_mode(mode), seed=seed), settings)
    if config.mode != mode:
        raise InvalidConfigError(
            f"mode is {config.mode!r} by a setting, which would leave the settings of {mode!r}; "
            f"give --mode {config.mode} (in Python: mode={config.mode!r})"
        )
    return config


def load(path: Path | str, recording: Recording | Path | str | None = None) -> Run:
    """Read a run that `Run.save` or `clothtrack track` has written.

    Args:
        path: NAME.zarr.
        recording: the recording it was tracked from, or the folder that contains recordings by
            name. By default it is searched beside NAME.zarr, in recordings/ beside its folder, and
            among those shipped with clothtrack.

    Raises:
        InvalidResultError: the run is missing, unfinished, damaged or from another version.
        InvalidRecordingError: the given recording is missing or unreadable.
    """
    path = Path(path)
    tracked = load_tracked(path)
    if recording is None:
        source = _recording_near(tracked, path)
    elif isinstance(recording, Recording):
        source = recording
    else:
        folder = recording_folder(tracked, Path(recording))
        source = read_recording(folder)
        require_own(tracked, source, artifact=path, folder=folder)
        warn_of_age(tracked, source, artifact=path, folder=folder)
    return Run.of(tracked, source, path)


def evaluate(
    run: TrackedTrajectory,
    recording: Recording | Path | str | None = None,
    truth: Truth | Path | str | None = None,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
    seed: int = 0,
) -> results.Evaluation:
    """Measure a run at the end of each action; `print` the result to see the table.

    Args:
        run: what `track` or `load` returned.
        recording: the recording it was tracked from; the run's own by default.
        truth: the true meshes if known, their NPZ file, or the folder that contains NAME.npz.
        segmenter: finds the cloth in a picture; the recording's masks or colors by default.
        device: "cpu" or "cuda:0", for visibility.
        seed: random seed of surface samples.

    Raises:
        InvalidRecordingError: the recording is not known.
        InvalidResultError: run, recording and truth do not belong together.
        InvalidConfigError: there is no such device.
    """
    quiet_warp()
    require_device(device)
    source, known = recording_of(run, recording), truth_of(run, truth)
    return results.evaluate(run, source, known, segmenter=segmenter, device=device, seed=seed)


def recording_of(
    run: TrackedTrajectory, recording: Recording | Path | str | None = None
) -> Recording:
    """Return the given recording, or the run's own.

    Raises:
        InvalidRecordingError: neither is known.
    """
    if recording is not None:
        return _read(recording)
    if isinstance(run, Run) and run.recording is not None:
        return run.recording
    raise InvalidRecordingError(
        f"{run.name}: its recording was not found; add --recordings FOLDER (in Python: "
        "load(PATH, recording=FOLDER))"
    )


def truth_of(run: TrackedTrajectory, truth: Truth | Path | str | None) -> Truth | None:
    """Return the true meshes of a run, read from their file or folder if that is given.

    Raises:
        InvalidResultError: the file is missing or damaged.
    """
    if isinstance(truth, Path | str):
        return Truth.load(inside(Path(truth), f"{run.name}.npz"))
    return truth


def _read(recording: Recording | Path | str) -> Recording:
    return recording if isinstance(recording, Recording) else read_recording(Path(recording))


def _recording_near(tracked: TrackedTrajectory, path: Path) -> Recording | None:
    """Return the recording near a run that has its name and its digest; None if there is none."""
    folders = [path.parent / tracked.name, path.parent.parent / "recordings" / tracked.name]
    with suppress(ClothTrackError):
        folders.append(shipped_recording(tracked.name))
    for folder in folders:
        # A damaged recording, or another one of the same name, was not tracked.
        with suppress(ClothTrackError):
            recording = read_recording(folder)
            if recording_digest(recording) == tracked.provenance.get(DIGEST_FIELD):
                return recording
    return None
