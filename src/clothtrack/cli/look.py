"""The verbs for what was tracked: evaluate, view (a page, served or in a file) and export."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

import clothtrack as ct
from clothtrack.cli.options import AsJson, Device, Seed
from clothtrack.cli.terminal import complain, progress, say
from clothtrack.errors import ClothTrackError, InvalidConfigError

if TYPE_CHECKING:
    from clothtrack.report.artefact_pages import IndexEntry


def evaluate(
    tracked: Positional[tuple[Path, ...]],
    *,
    recordings: Path,
    truth: Path | None = None,
    output: Path | None = None,
    device: Device = "cpu",
    seed: Seed = 0,
    json: AsJson = False,
) -> int:
    """Measure tracked trajectories, judge their labels, and compare with the truth if it is known.

    Args:
        tracked: NAME.zarr folders that `track` wrote.
        recordings: the recording, or the folder in which recordings lie by name.
        truth: truth file, or the folder in which NAME.npz lie.
        output: also write the rows to this JSON file.
        device: where to compute.
        seed: of surface samples.
        json: machine-readable.
    """
    from clothtrack.evaluation.results import as_json, save_json, table

    if not tracked:
        complain("no tracked trajectory given; name at least one NAME.zarr folder")
        return 2
    evaluations = [
        ct.evaluate(ct.load(path, recordings), truth=truth, device=device, seed=seed)
        for path in tracked
    ]
    if output is not None:
        save_json(evaluations, output)
    say(as_json(evaluations) if json else table(evaluations))
    return 0


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
    trajectories = [] if (artefact / "recording.json").exists() else sorted(artefact.glob("*.zarr"))
    if trajectories:
        return _view_folder(trajectories, recordings, truth, html)
    page = ct.view(
        artefact, recordings, truth=truth, html=html, port=port,
        opened=lambda address: say(f"{address}   open this; Ctrl-C ends"),
    )  # fmt: skip
    if page is not None:
        say(str(page))
    return 0


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
    run = ct.load(artefact, recordings)
    say(str(ct.export(run, output, format, rows=rows, truth=truth)))
    return 0


def _view_folder(
    trajectories: list[Path], recordings: Path | None, truth: Path | None, html: Path | None
) -> int:
    """Reports of all, and an index; a trajectory that cannot be shown is a line that says why."""
    from clothtrack.report.artefact_pages import write_index

    if recordings is None:
        raise InvalidConfigError(
            "a tracked trajectory is looked at over its recording; add --recordings FOLDER"
        )
    folder = trajectories[0].parent
    index = html or folder / "index.html"
    entries = []
    for number, path in enumerate(trajectories, 1):
        progress(f"report of {path.stem}", number, len(trajectories))
        entries.append(_entry(path, recordings, truth, index.parent))
    say(str(write_index(entries, folder.resolve().name, index)))
    return 1 if all(entry.page is None for entry in entries) else 0


def _entry(path: Path, recordings: Path, truth: Path | None, folder: Path) -> "IndexEntry":
    from clothtrack.front.look import review_of
    from clothtrack.report.artefact_pages import IndexEntry

    try:
        run = ct.load(path, recordings)
        verdicts = Counter(label.verdict for label in review_of(run).labels)
        page = ct.write_report(run, folder / f"{path.stem}.html", truth=truth)
    except ClothTrackError as error:
        return IndexEntry(path.stem, None, f"no report: {error}")
    return IndexEntry(
        path.stem,
        page,
        f"{len(run.frames)} frames, {len(run.actions)} actions",
        ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items())),
    )
