"""Look at a run, a recording or a mesh, and write a run for other programs."""

import logging
from collections.abc import Callable
from functools import partial
from pathlib import Path

from clothtrack.errors import InvalidConfigError
from clothtrack.evaluation.label_review import LabelReview, read_review, review_path
from clothtrack.evaluation.truth import Truth
from clothtrack.front.export_format import Format, export_format
from clothtrack.front.run import Run, load, recording_of, truth_of
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.mesh_file import MESH_SUFFIXES, read_mesh, read_vertex_errors
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.store import read_recording
from clothtrack.report import exports, live, page
from clothtrack.report.artefact_pages import (
    TrajectorySummary,
    summary_of,
    write_mesh_page,
    write_recording_page,
)
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

logger = logging.getLogger(__name__)

IMPORTED_SUFFIXES = (".bag", ".db3", ".mcap", ".mkv")
VIEWED = (
    "view takes NAME.zarr that `track` wrote, a folder of them, a recording (a folder with "
    "recording.json), or a mesh (.obj, .ply, .stl)"
)


def view(
    thing: TrackedTrajectory | Recording | ClothMesh | Path | str,
    recording: Recording | Path | str | None = None,
    *,
    truth: Truth | Path | str | None = None,
    html: Path | str | None = None,
    port: int | None = None,
    opened: Callable[[str], None] | None = None,
) -> Path | None:
    """Look at a run, a recording or a mesh in a browser until Ctrl-C is pressed.

    In the page of a run that lies on disk, A accepts and R rejects the label of an action. Each
    decision is saved at once beside the run, in NAME.review.json.

    Args:
        thing: it, or where it lies: NAME.zarr, a folder with recording.json, or a mesh file.
        recording: of a run, or the folder in which it lies by name; found as by `load` if left out.
        truth: of a run, as for `evaluate`; colours the error against it.
        html: write the page to this file instead of serving it; the file needs no network.
        port: of the local server, which listens on this machine only; any free one by default.
        opened: called with the page's address; by default standard error says it.

    Returns:
        Where the page is, if it was written to a file.

    Raises:
        InvalidConfigError: there is nothing to look at, or the truth is of nothing tracked.
        InvalidRecordingError: the recording is not known.
        InvalidResultError: the run or the decisions about its labels cannot be read.
    """
    if html is not None:
        require_file_name(Path(html))
    artefact, decisions = _opened(thing, recording), None
    if not isinstance(artefact, TrackedTrajectory) and truth is not None:
        raise InvalidConfigError(f"--truth: {thing} is not tracked; leave it out")
    if isinstance(artefact, Recording):
        name, write = artefact.name, partial(write_recording_page, artefact)
    elif isinstance(artefact, ClothMesh):
        name = Path(thing).name if isinstance(thing, Path | str) else "mesh"
        errors = read_vertex_errors(Path(thing)) if isinstance(thing, Path | str) else None
        write = partial(write_mesh_page, artefact, name, expected_error_m=errors)
    else:
        name = artefact.name
        source = recording_of(artefact, recording if artefact is thing else None)
        known, review = truth_of(artefact, truth), review_of(artefact)
        write = partial(page.write_report, artefact, source, truth=known, review=review)
        if (path := _review_file(artefact)) is not None:
            decisions = live.Decisions(review, path)
    if html is not None:
        return write(Path(html))
    live.serve(name, write, port, decisions=decisions, opened=opened or _say_address)
    return None


def require_file_name(html: Path) -> None:
    """Refuse a page under the name of a folder before any work is done.

    Raises:
        InvalidConfigError: there is such a folder.
    """
    if html.is_dir():
        raise InvalidConfigError(f"{html} is a folder; name a file in it: {html / 'page.html'}")


def write_report(run: Run, html: Path | str, *, truth: Truth | Path | str | None = None) -> Path:
    """Write the page of a run, which needs no network, and return where it is.

    Args:
        run: what `track` or `load` returned.
        html: the file.
        truth: as for `evaluate`.
    """
    known, review = truth_of(run, truth), review_of(run)
    return page.write_report(run, recording_of(run), Path(html), truth=known, review=review)


def export(
    run: TrackedTrajectory,
    output: Path | str,
    format: Format | None = None,  # noqa: A002
    *,
    rows: int = 6,
    truth: Truth | Path | str | None = None,
) -> Path:
    """Write a run for other programs, or as pictures for a paper, and return where it is.

    Args:
        run: what `track` or `load` returned.
        output: folder (obj, ply: one file per frame) or file (the others).
        format: npz, obj or ply: the meshes; sheet: a contact sheet as PNG; mp4: the mesh over the
            observation; rrd: everything for Rerun's viewer, needs the extra [rerun]. By default
            what the name ends in says it, and without a suffix it is obj.
        rows: frames on the sheet.
        truth: as for `evaluate`; adds the error to an rrd.

    Raises:
        InvalidConfigError: there is no such format, it contradicts the suffix, or there is no row.
        InvalidRecordingError: pictures need the recording, and it is not known.
    """
    if rows < 1:
        raise InvalidConfigError(f"rows is {rows}; a sheet needs 1 or more")
    kind = export_format(Path(output), format)
    if kind in ("sheet", "mp4", "rrd"):
        source, known = recording_of(run), truth_of(run, truth)
        return exports.export_pictures(run, source, Path(output), kind, rows=rows, truth=known)
    return exports.export(run, Path(output), kind)


def review_of(run: TrackedTrajectory) -> LabelReview:
    """What was decided about the labels of a run; nothing yet where it does not lie on disk.

    Raises:
        InvalidResultError: the decisions are damaged, or about other meshes.
    """
    path = _review_file(run)
    return LabelReview.blank(run) if path is None else read_review(path, run)


def summarised(run: Run) -> TrajectorySummary:
    """What an index says about a run.

    Raises:
        InvalidRecordingError: the recording is not known.
    """
    return summary_of(run, recording_of(run))


def _review_file(run: TrackedTrajectory) -> Path | None:
    path = run.path if isinstance(run, Run) else None
    return None if path is None else review_path(path)


def _opened(
    thing: TrackedTrajectory | Recording | ClothMesh | Path | str,
    recording: Recording | Path | str | None,
) -> TrackedTrajectory | Recording | ClothMesh:
    if not isinstance(thing, Path | str):
        return thing
    path = Path(thing)
    if path.suffix.lower() in MESH_SUFFIXES:
        return read_mesh(path)
    if (path / "recording.json").exists():
        return read_recording(path)
    if (path / "zarr.json").exists():
        return load(path, recording)
    raise InvalidConfigError(_nothing_to_view(path))


def _nothing_to_view(path: Path) -> str:
    """What `view` takes, what lies there instead, and what may have been meant."""
    if not path.exists():
        return f"{path}: there is no such file or folder; {VIEWED}"
    if path.is_file():
        suffix = path.suffix.lower()
        kind = f"a {suffix} file" if suffix else "a file without a suffix"
        if suffix in IMPORTED_SUFFIXES:
            return f"{path} is {kind}; make a recording of it first: clothtrack import"
        return f"{path} is {kind}; {VIEWED}"
    if path.suffix == ".zarr":
        return f"{path} has no zarr.json: it was not finished; track the recording again"
    inside = sorted(path.iterdir())
    for entry in inside:
        if (entry / "recording.json").exists() or entry.suffix.lower() in MESH_SUFFIXES:
            return f"{path} holds several things; view one of them, such as {entry}"
    names = ", ".join(entry.name for entry in inside[:3]) or "nothing"
    more = f" and {len(inside) - 3} more" if len(inside) > 3 else ""
    return f"{path} is a folder with {names}{more}; {VIEWED}"


def _say_address(address: str) -> None:
    logger.warning("open %s; Ctrl-C ends", address)
