"""Track a recording; measure, look at and export what came of it."""

import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

from clothtrack.errors import (
    ClothTrackError,
    InvalidConfigError,
    InvalidRecordingError,
)
from clothtrack.files.settings import with_settings
from clothtrack.geometry.devices import quiet_warp, require_device
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.identity import DIGEST_FIELD, recording_digest
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.recordings.shipped import shipped_recording
from clothtrack.recordings.store import read_recording
from clothtrack.tracking.artefacts import load_tracked
from clothtrack.tracking.configuration import mode as tracker_mode
from clothtrack.tracking.pipeline import Progress, RunConfig, track_recording
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

if TYPE_CHECKING:
    from clothtrack.evaluation.results import Evaluation
    from clothtrack.evaluation.truth import Truth

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Label:
    """The mesh at the end of an action, and how far it can be trusted.

    Attributes:
        action: number of the action, from 0.
        frame: frame of the recording.
        positions: vertices after the final alignment [m].
        quality: weight for training in 0..1; one half is typical of the benchmark.
        expected_error_mm: mean vertex error to expect [mm]; NaN where nothing was seen.
    """

    action: int
    frame: int
    positions: Float[np.ndarray, "vertices 3"]
    quality: float
    expected_error_mm: float


@dataclass(frozen=True, eq=False)
class Run(TrackedTrajectory):
    """A tracked trajectory with the recording that it was tracked from.

    It is a `TrackedTrajectory`: whatever takes one takes a run. Of its many attributes these matter
    most; docs/result_format.md has them all.

    Attributes:
        positions: vertex positions in the world [m], (frames, vertices, 3).
        visible: whether some camera sees the vertex, (frames, vertices).
        mesh: topology, rest shape and canonical coordinates.
        actions: what was found for each pick-and-place: parameters, calibration, held vertices.
        config: every setting of the run.
        provenance: versions, commit, seed, device, and the recording's own provenance.
        recording: what was tracked; None when it was not found.
    """

    recording: Recording | None = None

    @classmethod
    def of(cls, tracked: TrackedTrajectory, recording: Recording | None) -> "Run":
        """The same trajectory together with its recording."""
        values = {field.name: getattr(tracked, field.name) for field in fields(TrackedTrajectory)}
        return cls(**values, recording=recording)

    @cached_property
    def labels(self) -> tuple[Label, ...]:
        """The mesh at the end of each action, judged by what was observed.

        Raises:
            InvalidRecordingError: the recording is not known.
        """
        from clothtrack.evaluation.label_quality import judge_labels

        judged = judge_labels(self, recording_of(self))
        return tuple(
            Label(
                one.action,
                one.frame,
                action.positions_after_final_alignment,
                one.label_quality,
                one.expected_error_mm,
            )
            for one, action in zip(judged, self.actions, strict=True)
        )

    def view(self, *, port: int | None = None) -> None:
        """Look at it in a browser until Ctrl-C is pressed.

        Args:
            port: of the local server, which listens on this machine only; any free one by default.
        """
        from clothtrack.report.page import write_report as write_page

        source = recording_of(self)
        _serve(self.name, lambda path: write_page(self, source, path), port)

    def report(self, html: Path | str, *, truth: "Truth | None" = None) -> Path:
        """Write one page that needs no network, and return where it is.

        Args:
            html: the file.
            truth: the true meshes, where somebody knows them.
        """
        from clothtrack.report.page import write_report as write_page

        return write_page(self, recording_of(self), Path(html), truth=truth)


def track(
    recording: Recording | Path | str,
    config: RunConfig | None = None,
    *,
    mode: str = "default",
    settings: Sequence[str] = (),
    device: str = "cpu",
    segmenter: Segmenter | None = None,
    progress: Progress | None = None,
    **parts: Any,
) -> Run:
    """Track a recording: the full mesh, hidden layers included, at every frame (Algorithm 1).

    Args:
        recording: a folder with recording.json, or a recording that was read.
        config: the whole configuration; that of `mode` by default.
        mode: one of `MODES`: our default, the paper's method, or an ablation of it.
        settings: changes to the configuration, such as "tracker.alignment.iterations=50".
        device: "cpu" or "cuda:0".
        segmenter: finds the cloth in a picture; the recording's masks or colours by default.
        progress: called after every frame with the recording's name, frames done and in all.
        **parts: replacements for parts of Algorithm 1: observe, pick, calibrate, dynamics, align,
            line_search, align_last.

    Raises:
        InvalidRecordingError: the recording cannot be used.
        InvalidConfigError: unknown mode, setting, part or device; or both a config and a mode.
    """
    quiet_warp()
    require_device(device)
    if config is not None and mode != "default":
        raise InvalidConfigError(
            f"both a config and mode={mode!r} were given; leave one out, or give "
            f"RunConfig(tracker=mode({mode!r}))"
        )
    whole = with_settings(config or RunConfig(tracker=tracker_mode(mode)), settings)
    source = _read(recording)
    tracked = track_recording(
        source, whole, device=device, segmenter=segmenter, progress=progress, parts=parts
    )
    return Run.of(tracked, source)


def load(path: Path | str, recording: Recording | Path | str | None = None) -> Run:
    """Read a run that `Run.save` or `clothtrack track` has written.

    Args:
        path: NAME.zarr.
        recording: what it was tracked from. By default it is looked for beside NAME.zarr, in
            recordings/ beside its folder, and among those that come with clothtrack.

    Raises:
        InvalidResultError: the run is missing, unfinished, damaged or from another version.
    """
    path = Path(path)
    tracked = load_tracked(path)
    found = _found(tracked, path) if recording is None else _read(recording)
    return Run.of(tracked, found)


def evaluate(
    run: Run | TrackedTrajectory,
    recording: Recording | Path | str | None = None,
    truth: "Truth | Path | str | None" = None,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
    seed: int = 0,
) -> "Evaluation":
    """Measure a run at the end of each action; `print` it to see the table.

    Args:
        run: what `track` or `load` returned.
        recording: what it was tracked from; the run's own by default.
        truth: the true meshes, or their NPZ file, where somebody knows them.
        segmenter: finds the cloth in a picture; the recording's own way by default.
        device: "cpu" or "cuda:0", for visibility.
        seed: of surface samples.

    Raises:
        InvalidRecordingError: the recording is not known.
        InvalidResultError: run, recording and truth do not belong together.
    """
    from clothtrack.evaluation.results import evaluate as measure
    from clothtrack.evaluation.truth import Truth

    quiet_warp()
    known = Truth.load(Path(truth)) if isinstance(truth, Path | str) else truth
    source = recording_of(run, recording)
    return measure(run, source, known, segmenter=segmenter, device=device, seed=seed)


def view(
    thing: Run | Recording | ClothMesh | Path | str,
    recording: Recording | Path | str | None = None,
    *,
    port: int | None = None,
) -> None:
    """Look at a run, a recording or a mesh in a browser until Ctrl-C is pressed.

    Args:
        thing: it, or where it lies: NAME.zarr, or a folder with recording.json.
        recording: of a run, when it is not found.
        port: of the local server, which listens on this machine only; any free one by default.
    """
    from clothtrack.report.artefact_pages import write_mesh_page, write_recording_page

    if isinstance(thing, Path | str):
        is_recording = (Path(thing) / "recording.json").exists()
        thing = read_recording(Path(thing)) if is_recording else load(thing, recording)
    if isinstance(thing, Recording):
        shown = thing
        _serve(shown.name, lambda path: write_recording_page(shown, path), port)
    elif isinstance(thing, ClothMesh):
        mesh = thing
        _serve("mesh", lambda path: write_mesh_page(mesh, "mesh", path), port)
    else:
        Run.of(thing, recording_of(thing, recording)).view(port=port)


def _serve(name: str, write: Callable[[Path], Path], port: int | None) -> None:
    """Serve a page until Ctrl-C is pressed; its address goes to standard error."""
    from clothtrack.report.live import serve

    serve(name, write, port, opened=lambda at: logger.warning("open %s; Ctrl-C ends", at))


def write_report(run: Run, html: Path | str, *, truth: "Truth | None" = None) -> Path:
    """Write the page of a run, which needs no network, and return where it is.

    Args:
        run: what `track` or `load` returned.
        html: the file.
        truth: the true meshes, where somebody knows them.
    """
    return run.report(html, truth=truth)


def export(
    run: Run | TrackedTrajectory,
    output: Path | str,
    format: Literal["npz", "obj", "ply", "sheet", "mp4", "rrd"] = "npz",  # noqa: A002
    *,
    rows: int = 6,
) -> Path:
    """Write a run for other programs, or as pictures for a paper, and return where it is.

    Args:
        run: what `track` or `load` returned.
        output: folder (obj, ply: one file per frame) or file (the others).
        format: npz, obj or ply: the meshes; sheet: a contact sheet as PNG; mp4: the mesh over the
            observation; rrd: everything for Rerun's viewer, needs the extra [rerun].
        rows: frames on the sheet.

    Raises:
        InvalidConfigError: there is no such format.
        InvalidRecordingError: pictures need the recording, and it is not known.
    """
    if format in ("sheet", "mp4", "rrd"):
        from clothtrack.report.for_papers import export_pictures

        return export_pictures(run, recording_of(run), Path(output), format, rows=rows)
    from clothtrack.report.mesh_export import export as export_meshes

    return export_meshes(run, Path(output), format)


def _read(recording: Recording | Path | str) -> Recording:
    return recording if isinstance(recording, Recording) else read_recording(Path(recording))


def recording_of(run: TrackedTrajectory, given: Recording | Path | str | None = None) -> Recording:
    """The given recording, or the run's own.

    Raises:
        InvalidRecordingError: neither is known.
    """
    if given is not None:
        return _read(given)
    if isinstance(run, Run) and run.recording is not None:
        return run.recording
    raise InvalidRecordingError(
        f"{run.name}: its recording was not found; name it: load(PATH, recording=FOLDER)"
    )


def _found(tracked: TrackedTrajectory, path: Path) -> Recording | None:
    """The recording of a run where one lies by its name and is what was tracked."""
    folders = [path.parent / tracked.name, path.parent.parent / "recordings" / tracked.name]
    with suppress(ClothTrackError):
        folders.append(shipped_recording(tracked.name))
    for folder in folders:
        if (folder / "recording.json").is_file():
            recording = read_recording(folder)
            if recording_digest(recording) == tracked.provenance.get(DIGEST_FIELD):
                return recording
    return None
