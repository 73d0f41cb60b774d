"""View a run, a recording or a mesh, and export a run for other programs."""

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clothtrack.api.export_format import Format, export_format
from clothtrack.errors import ClothTrackError, InvalidConfigError

if TYPE_CHECKING:
    from clothtrack.api.run import Run
    from clothtrack.evaluation.label_review import LabelReview
    from clothtrack.evaluation.truth import Truth
    from clothtrack.files.progress import Progress
    from clothtrack.geometry.mesh import ClothMesh
    from clothtrack.recordings.recording import Recording
    from clothtrack.report.artifact_pages import IndexEntry
    from clothtrack.report.live import Report
    from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

logger = logging.getLogger(__name__)

_IMPORTED_SUFFIXES = (".bag", ".db3", ".mcap", ".mkv")
_VIEWED = (
    "view takes NAME.zarr that `track` wrote, a folder of them, a recording (a folder with "
    "recording.json), or a mesh (.obj, .ply, .stl)"
)


@dataclass(frozen=True)
class Page:
    """The page that `view` has written.

    Attributes:
        page: the page, or the index of a folder.
        reports: for a folder, the report of each trajectory; None where there is none.
    """

    page: Path
    reports: tuple[Path | None, ...] | None = None

    @property
    def exit_code(self) -> int:
        """1 if no trajectory of a folder has a report."""
        return 1 if self.reports is not None and not any(self.reports) else 0

    def text(self) -> str:
        """Return the path of the page."""
        return str(self.page)

    def as_dict(self) -> dict[str, Any]:
        """Return the same as JSON-compatible values."""
        return {"page": self.page} | ({} if self.reports is None else {"reports": self.reports})


def view(
    thing: "TrackedTrajectory | Recording | ClothMesh | Path | str",
    recordings: "Recording | Path | str | None" = None,
    *,
    truth: "Truth | Path | str | None" = None,
    html: Path | str | None = None,
    progress: "Progress | None" = None,
    opened: "Callable[[str], None] | None" = None,
) -> Page | None:
    """View a tracked trajectory, a folder of them, a recording, or a mesh.

    The page is served to a browser on this machine until Ctrl-C; with --html it is written to a
    file that needs no network. On the page of a trajectory, the keys A and R accept and reject the
    label of an action; the served page saves this beside the trajectory, in NAME.review.json.

    Args:
        thing: NAME.zarr that `track` wrote, a folder of them, a recording, or an OBJ, PLY or STL
            file; in Python also a run, a recording or a mesh itself.
        recordings: for trajectories: the recording, or the folder that contains recordings by name;
            by default it is searched as by `load`.
        truth: truth file, or the folder that contains NAME.npz; colors the error against it.
        html: write one self-contained page here instead of serving; for a folder of trajectories,
            the index, with the reports beside it.
        progress: called for each trajectory of a folder.
        opened: called with the page's address; by default it goes to standard error.

    Returns:
        The page, if it was written to a file.

    Raises:
        InvalidConfigError: there is nothing to view, or the truth is for something not tracked.
        InvalidRecordingError: the recording is not known.
        InvalidResultError: the run or the decisions about its labels cannot be read.
    """
    from clothtrack.report import live

    if html is not None:
        _require_file_name(Path(html))
    show = opened or _say_address
    trajectories = _trajectories(thing)
    if trajectories:
        if recordings is None:
            _require_recording(trajectories[0])
        if html is None:
            _serve_folder(trajectories, recordings, truth, show, progress)
            return None
        return _write_folder(trajectories, recordings, truth, Path(html), progress)
    name, write, decisions = _shown(thing, recordings, truth)
    if html is not None:
        return Page(write(Path(html)))
    live.serve(name, write, None, decisions=decisions, opened=show)
    return None


def _shown(
    thing: "TrackedTrajectory | Recording | ClothMesh | Path | str",
    recordings: "Recording | Path | str | None",
    truth: "Truth | Path | str | None",
) -> tuple[str, Callable[[Path], Path], Any]:
    """Return the name of one artifact, the function that writes its page, and its decisions."""
    from clothtrack.api.reconstructed_mesh import ReconstructedMesh
    from clothtrack.api.run import recording_of, truth_of
    from clothtrack.geometry.mesh import ClothMesh
    from clothtrack.recordings.mesh_file import read_vertex_errors
    from clothtrack.recordings.recording import Recording
    from clothtrack.report import live, page
    from clothtrack.report.artifact_pages import write_mesh_page, write_recording_page
    from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

    artifact = _opened(thing, recordings)
    if not isinstance(artifact, TrackedTrajectory) and truth is not None:
        raise InvalidConfigError(f"--truth: {thing} is not tracked; leave it out")
    if isinstance(artifact, Recording):
        return artifact.name, partial(write_recording_page, artifact), None
    if isinstance(artifact, ClothMesh):
        file = Path(thing) if isinstance(thing, Path | str) else None
        name = file.name if file else "mesh"
        errors, verdict = read_vertex_errors(file) if file else None, None
        if isinstance(artifact, ReconstructedMesh):
            errors, verdict = artifact.network.spread_m, artifact.verdict
        write = partial(write_mesh_page, artifact, name, expected_error_m=errors, verdict=verdict)
        return name, write, None
    source = recording_of(artifact, recordings if artifact is thing else None)
    known, review = truth_of(artifact, truth), review_of(artifact)
    write = partial(page.write_report, artifact, source, truth=known, review=review)
    path = _review_file(artifact)
    return artifact.name, write, None if path is None else live.Decisions(review, path)


def _require_file_name(html: Path) -> None:
    """Refuse a page that has the name of a folder, before any work is done.

    Raises:
        InvalidConfigError: there is such a folder.
    """
    if html.is_dir():
        raise InvalidConfigError(f"{html} is a folder; name a file in it: {html / 'page.html'}")


def write_report(
    run: "Run", html: Path | str, *, truth: "Truth | Path | str | None" = None
) -> Path:
    """Write the page of a run, which needs no network, and return its path.

    Args:
        run: what `track` or `load` returned.
        html: the file.
        truth: as for `evaluate`.
    """
    from clothtrack.api.run import recording_of, truth_of
    from clothtrack.report import page

    known, review = truth_of(run, truth), review_of(run)
    return page.write_report(run, recording_of(run), Path(html), truth=known, review=review)


def export(
    run: "TrackedTrajectory | Path | str",
    output: Path | str,
    format: Format | None = None,  # noqa: A002
    *,
    recordings: Path | str | None = None,
    rows: int = 6,
) -> Path:
    """Write a tracked trajectory in a format that other programs read, or as pictures for a paper.

    Args:
        run: NAME.zarr that `track` wrote; in Python also a run itself.
        output: file, whose suffix gives the format (.npz, .png, .mp4), or folder (obj, ply, glb:
            one file per frame).
        format: obj, ply, glb or npz: the meshes; sheet: a contact sheet as PNG; mp4: the mesh over
            the observation; by default the format of the output's suffix, or obj without a suffix.
        recordings: for sheet and mp4: the recording, or the folder that contains it by name;
            by default it is searched as by `load`.
        rows: number of frames on the sheet.

    Returns:
        Path of the export.

    Raises:
        InvalidConfigError: the format is unknown or contradicts the suffix, or there is no row.
        InvalidRecordingError: pictures need the recording, and it is not known.
    """
    if rows < 1:
        raise InvalidConfigError(f"rows is {rows}; a sheet needs 1 or more")
    kind = export_format(Path(output), format)
    from clothtrack.api.run import load, recording_of
    from clothtrack.report import exports

    whole = load(run, recordings) if isinstance(run, Path | str) else run
    if kind not in ("sheet", "mp4"):
        return exports.export(whole, Path(output), kind)
    return exports.export_pictures(whole, recording_of(whole), Path(output), kind, rows=rows)


def review_of(run: "TrackedTrajectory") -> "LabelReview":
    """Return the decisions about the labels of a run; a blank review if it is not on disk.

    Raises:
        InvalidResultError: the decisions are damaged, or about other meshes.
    """
    from clothtrack.evaluation.label_review import LabelReview, read_review

    path = _review_file(run)
    return LabelReview.blank(run) if path is None else read_review(path, run)


def _review_file(run: "TrackedTrajectory") -> Path | None:
    from clothtrack.api.run import Run
    from clothtrack.evaluation.label_review import review_path

    path = run.path if isinstance(run, Run) else None
    return None if path is None else review_path(path)


def _opened(
    thing: "TrackedTrajectory | Recording | ClothMesh | Path | str",
    recording: "Recording | Path | str | None",
) -> "TrackedTrajectory | Recording | ClothMesh":
    from clothtrack.api.run import load
    from clothtrack.recordings.mesh_file import READ_SUFFIXES, read_mesh
    from clothtrack.recordings.store import read_recording

    if not isinstance(thing, Path | str):
        return thing
    path = Path(thing)
    if path.suffix.lower() in READ_SUFFIXES:
        return read_mesh(path)
    if (path / "recording.json").exists():
        return read_recording(path)
    if (path / "zarr.json").exists():
        return load(path, recording)
    raise InvalidConfigError(_nothing_to_view(path))


def _nothing_to_view(path: Path) -> str:
    """Return what `view` takes, what the path is instead, and what may be meant."""
    from clothtrack.recordings.mesh_file import READ_SUFFIXES

    if not path.exists():
        return f"{path}: there is no such file or folder; {_VIEWED}"
    if path.is_file():
        suffix = path.suffix.lower()
        kind = f"a {suffix} file" if suffix else "a file without a suffix"
        if suffix in _IMPORTED_SUFFIXES:
            return f"{path} is {kind}; make a recording of it first: clothtrack import"
        return f"{path} is {kind}; {_VIEWED}"
    if path.suffix == ".zarr":
        return f"{path} has no zarr.json: it was not finished; track the recording again"
    inside = sorted(path.iterdir())
    for entry in inside:
        if (entry / "recording.json").exists() or entry.suffix.lower() in READ_SUFFIXES:
            return f"{path} holds several things; view one of them, such as {entry}"
    names = ", ".join(entry.name for entry in inside[:3]) or "nothing"
    more = f" and {len(inside) - 3} more" if len(inside) > 3 else ""
    return f"{path} is a folder with {names}{more}; {_VIEWED}"


def _say_address(address: str) -> None:
    logger.warning("open %s; Ctrl-C ends", address)


def _trajectories(thing: object) -> list[Path]:
    """Return the trajectories of a folder; for anything else, an empty list."""
    if not isinstance(thing, Path | str) or (Path(thing) / "recording.json").exists():
        return []
    return sorted(Path(thing).glob("*.zarr"))


def _require_recording(trajectory: Path) -> None:
    """Refuse a folder whose first trajectory has no recording near it, before a page is served."""
    from clothtrack.api.run import load, recording_of
    from clothtrack.errors import InvalidRecordingError

    try:
        recording_of(load(trajectory))
    except InvalidRecordingError:
        raise
    except ClothTrackError:
        # A damaged one gets a line in the index.
        return


def _write_folder(
    trajectories: Sequence[Path],
    recordings: "Recording | Path | str | None",
    truth: "Truth | Path | str | None",
    index: Path,
    progress: "Progress | None",
) -> Page:
    """Write all reports and an index; a trajectory that cannot be shown gets a line saying why."""
    from clothtrack.report.artifact_pages import write_index

    entries = []
    for done, path in enumerate(trajectories):
        if progress is not None:
            place = f"report of {path.stem}, {done + 1}/{len(trajectories)}"
            progress(place, done, len(trajectories))
        entry, run = _entry(path, recordings, index.parent)
        try:
            if run is not None and entry.page is not None:
                write_report(run, entry.page, truth=truth)
        except ClothTrackError as error:
            entry = replace(entry, page=None, description=f"no report: {error}", verdicts="")
        entries.append(entry)
    page = write_index(entries, trajectories[0].parent.resolve().name, index)
    return Page(page, tuple(entry.page for entry in entries))


def _serve_folder(
    trajectories: Sequence[Path],
    recordings: "Recording | Path | str | None",
    truth: "Truth | Path | str | None",
    opened: Callable[[str], None],
    progress: "Progress | None",
) -> None:
    """Serve an index and the reports, each made when it is opened; nothing stays in the folder."""
    from clothtrack.evaluation.label_review import review_path
    from clothtrack.report.artifact_pages import write_index
    from clothtrack.report.live import Decisions, Report, serve_folder

    title = trajectories[0].parent.resolve().name

    def load_all() -> "tuple[Callable[[Path], Path], dict[str, Report]]":
        entries, reports = [], {}
        for done, path in enumerate(trajectories):
            if progress is not None:
                place = f"read {path.stem}, {done + 1}/{len(trajectories)}"
                progress(place, done, len(trajectories))
            entry, run = _entry(path, recordings, path.parent)
            entries.append(entry)
            if run is not None:
                write = partial(write_report, run, truth=truth)
                reports[path.stem] = Report(write, Decisions(review_of(run), review_path(path)))
        if progress is not None:
            progress("all read", len(trajectories), len(trajectories))
        return partial(write_index, entries, title), reports

    serve_folder(title, load_all, None, opened=opened)


def _entry(
    path: Path, recordings: "Recording | Path | str | None", folder: Path
) -> "tuple[IndexEntry, Run | None]":
    """Return the line of a trajectory in an index, and its run if it can be read."""
    from clothtrack.api.run import load, recording_of
    from clothtrack.report.artifact_pages import IndexEntry, summary_of

    try:
        run = load(path, recordings)
        verdicts = Counter(label.verdict for label in review_of(run).labels)
        summary = summary_of(run, recording_of(run))
    except ClothTrackError as error:
        return IndexEntry(path.stem, None, f"no report: {error}"), None
    return IndexEntry(
        path.stem,
        folder / f"{path.stem}.html",
        f"{len(run.frames)} frames, {len(run.actions)} actions",
        ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items())),
        summary,
    ), run
