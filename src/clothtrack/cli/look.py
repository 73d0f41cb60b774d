"""The verbs of looking: view (a page, served or written to a file) and export."""

from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from clothtrack.cli.terminal import progress, say
from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.tracking.artefacts import inside, load_tracked, recording_of

if TYPE_CHECKING:
    from clothtrack.evaluation.truth import Truth
    from clothtrack.report.artefact_pages import IndexEntry
    from clothtrack.report.live import Decisions

IMPORTED_SUFFIXES = (".bag", ".db3", ".mcap", ".mkv")
VIEWED = (
    "view takes NAME.zarr that `track` wrote, a folder of them, a recording (a folder with "
    "recording.json), or a mesh (.obj, .ply, .stl)"
)


def view(
    artefact: Positional[Path],
    *,
    recordings: Path | None = None,
    truth: Path | None = None,
    html: Path | None = None,
    port: int | None = None,
) -> int:
    """Look at a tracked trajectory, a folder of them, a recording, or a mesh.

    The page is served to a browser on this machine until Ctrl-C, or with --html written to a file
    that needs no network. In the page of a trajectory A accepts and R rejects the label of an
    action; the served page saves that beside the trajectory, in NAME.review.json.

    Args:
        artefact: NAME.zarr that `track` wrote, a folder of them, a recording, or an OBJ, PLY or
            STL file.
        recordings: for trajectories: the recording, or the folder in which recordings lie by name.
        truth: truth file, or the folder in which NAME.npz lie; colours the error against it.
        html: write one self-contained page here instead of serving; of a folder of trajectories,
            the index, with the reports beside it (index.html in that folder by default).
        port: of the local server, which listens on this machine only; any free one by default.
    """
    from clothtrack.recordings.mesh_file import MESH_SUFFIXES

    if artefact.suffix.lower() in MESH_SUFFIXES:
        _refuse_truth(truth, artefact)
        return _view_mesh(artefact, html, port)
    if (artefact / "recording.json").exists():
        _refuse_truth(truth, artefact)
        return _view_recording(artefact, html, port)
    if artefact.is_dir() and not (artefact / "zarr.json").exists():
        trajectories = sorted(artefact.glob("*.zarr"))
        if trajectories:
            return _view_folder(trajectories, _needed(recordings), truth, html)
    if not (artefact / "zarr.json").exists():
        raise InvalidConfigError(_unknown(artefact))
    return _view_trajectory(artefact, recordings, truth, html=html, port=port)


def export(
    artefact: Positional[Path],
    *,
    output: Path,
    format: Literal["obj", "ply", "npz", "sheet", "mp4", "rrd"] = "obj",  # noqa: A002
    recordings: Path | None = None,
    truth: Path | None = None,
    rows: int = 6,
) -> int:
    """Write a tracked trajectory in a format that other programs read, or as pictures for a paper.

    Args:
        artefact: NAME.zarr that `track` wrote.
        output: folder (obj, ply: one file per frame) or file (the others).
        format: obj, ply or npz: the meshes; sheet: a contact sheet as PNG; mp4: the mesh over the
            observation; rrd: everything for Rerun's viewer, needs the extra [rerun].
        recordings: for sheet, mp4 and rrd: the recording, or the folder in which it lies by name.
        truth: for rrd: truth file, or the folder in which NAME.npz lie.
        rows: frames on the sheet.
    """
    if rows < 1:
        raise InvalidConfigError(f"rows is {rows}; a sheet needs 1 or more")
    tracked = load_tracked(artefact)
    if format in ("sheet", "mp4", "rrd"):
        from clothtrack.report.for_papers import export_pictures

        recording = recording_of(tracked, _needed(recordings), artefact)
        known = _truth_of(tracked.name, truth)
        say(str(export_pictures(tracked, recording, output, format, rows=rows, truth=known)))
        return 0
    from clothtrack.report.mesh_export import export as export_meshes

    say(str(export_meshes(tracked, output, format)))
    return 0


def _unknown(artefact: Path) -> str:
    """What `view` takes, what lies there instead, and what may have been meant."""
    from clothtrack.recordings.mesh_file import MESH_SUFFIXES

    if not artefact.exists():
        return f"{artefact}: there is no such file or folder; {VIEWED}"
    if artefact.is_file():
        kind = artefact.suffix.lower()
        found = f"a {kind} file" if kind else "a file without a suffix"
        if kind in IMPORTED_SUFFIXES:
            return f"{artefact} is {found}; make a recording of it first: clothtrack import"
        return f"{artefact} is {found}; {VIEWED}"
    inside_it = sorted(artefact.iterdir())
    if artefact.suffix == ".zarr":
        return f"{artefact} has no zarr.json: it was not finished; track the recording again"
    for one in inside_it:
        if (one / "recording.json").exists() or one.suffix.lower() in MESH_SUFFIXES:
            return f"{artefact} holds several things; view one of them, such as {one}"
    names = ", ".join(one.name for one in inside_it[:3]) or "nothing"
    more = f" and {len(inside_it) - 3} more" if len(inside_it) > 3 else ""
    return f"{artefact} is a folder with {names}{more}; {VIEWED}"


def _needed(recordings: Path | None) -> Path:
    if recordings is None:
        raise InvalidConfigError(
            "a tracked trajectory is looked at over its recording; add --recordings FOLDER"
        )
    return recordings


def _refuse_truth(truth: Path | None, artefact: Path) -> None:
    if truth is not None:
        raise InvalidConfigError(f"--truth: {artefact} is not tracked; leave it out")


def _truth_of(name: str, truth: Path | None) -> "Truth | None":
    from clothtrack.evaluation.truth import Truth

    return None if truth is None else Truth.load(inside(truth, f"{name}.npz"))


def _show(
    name: str,
    write: Callable[[Path], Path],
    html: Path | None,
    port: int | None,
    *,
    decisions: "Decisions | None" = None,
) -> int:
    """Write a page to `html`, or serve it until Ctrl-C."""
    if html is not None:
        say(str(write(html)))
        return 0
    from clothtrack.report.live import serve

    serve(name, write, port, decisions=decisions,
          opened=lambda address: say(f"{address}   open this; Ctrl-C ends"))  # fmt: skip
    return 0


def _view_trajectory(
    artefact: Path,
    recordings: Path | None,
    truth: Path | None,
    *,
    html: Path | None,
    port: int | None,
) -> int:
    from clothtrack.evaluation.label_review import read_review, review_path
    from clothtrack.report.live import Decisions
    from clothtrack.report.page import write_report

    tracked = load_tracked(artefact)
    recording = recording_of(tracked, _needed(recordings), artefact)
    known = _truth_of(tracked.name, truth)
    path = review_path(artefact)
    review = read_review(path, tracked)

    def write(page: Path) -> Path:
        return write_report(tracked, recording, page, truth=known, review=review)

    return _show(tracked.name, write, html, port, decisions=Decisions(review, path))


def _view_recording(artefact: Path, html: Path | None, port: int | None) -> int:
    from clothtrack.recordings.store import read_recording
    from clothtrack.report.artefact_pages import write_recording_page

    recording = read_recording(artefact)
    return _show(recording.name, partial(write_recording_page, recording), html, port)


def _view_mesh(artefact: Path, html: Path | None, port: int | None) -> int:
    from clothtrack.recordings.mesh_file import read_mesh
    from clothtrack.report.artefact_pages import write_mesh_page

    mesh, name = read_mesh(artefact), artefact.name
    return _show(name, partial(write_mesh_page, mesh, name), html, port)


def _view_folder(
    trajectories: list[Path], recordings: Path, truth: Path | None, html: Path | None
) -> int:
    """Reports of all, and an index; a trajectory that cannot be shown is a line that says why."""
    from clothtrack.report.artefact_pages import write_index

    folder = trajectories[0].parent
    index = html or folder / "index.html"
    entries = []
    for number, path in enumerate(trajectories, 1):
        progress(f"report of {path.stem}", number, len(trajectories))
        entries.append(_entry(path, recordings, truth, index.parent))
    say(str(write_index(entries, folder.resolve().name, index)))
    return 1 if all(entry.page is None for entry in entries) else 0


def _entry(path: Path, recordings: Path, truth: Path | None, folder: Path) -> "IndexEntry":
    from clothtrack.evaluation.label_review import read_review, review_path
    from clothtrack.report.artefact_pages import IndexEntry
    from clothtrack.report.page import write_report

    try:
        tracked = load_tracked(path)
        review = read_review(review_path(path), tracked)
        page = write_report(
            tracked,
            recording_of(tracked, recordings, path),
            folder / f"{path.stem}.html",
            truth=_truth_of(tracked.name, truth),
            review=review,
        )
    except ClothTrackError as error:
        return IndexEntry(path.stem, None, f"no report: {error}")
    verdicts = Counter(one.verdict for one in review.labels)
    return IndexEntry(
        path.stem,
        page,
        f"{len(tracked.frames)} frames, {len(tracked.actions)} actions",
        ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items())),
    )
