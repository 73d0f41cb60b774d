"""The verbs for what was tracked: evaluate, view (a page, served or in a file) and export."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

import clothtrack as ct
from clothtrack.cli.options import (
    AsJson,
    Device,
    Ray,
    Seed,
)
from clothtrack.cli.terminal import complain, progress, say, say_result
from clothtrack.errors import ClothTrackError, InvalidConfigError

if TYPE_CHECKING:
    from clothtrack.front.run import Run
    from clothtrack.report.artefact_pages import IndexEntry


def evaluate(
    tracked: Positional[tuple[Path, ...]],
    *,
    recordings: Path,
    truth: Path | None = None,
    output: Path | None = None,
    all: bool = False,  # noqa: A002
    workers: int = 1,
    ray: Ray = "",
    device: Device = "cpu",
    seed: Seed = 0,
    json: AsJson = False,
) -> int:
    """Measure tracked trajectories, judge their labels, and compare with the truth if it is known.

    Args:
        tracked: NAME.zarr folders that `track` wrote.
        recordings: the recording, or the folder in which recordings lie by name.
        truth: truth file, or the folder in which NAME.npz lie.
        output: also write all measures to this JSON file.
        all: show every measure, before and after the final alignment, in wide rows.
        workers: processes.
        ray: address of Ray, which is to do it.
        device: where to compute.
        seed: of surface samples.
        json: machine-readable.
    """
    from clothtrack.evaluation.results import as_json, summary, table
    from clothtrack.front.many import evaluate_many

    if not tracked:
        complain("no tracked trajectory given; name at least one NAME.zarr folder")
        return 2
    evaluations = evaluate_many(
        tracked, recordings, output, {"truth": truth, "device": device, "seed": seed},
        workers=workers, ray=ray, progress=progress,
    )  # fmt: skip
    shown = as_json if json else table if all else summary
    say(shown(evaluations))
    return 0


def view(
    artefact: Positional[Path],
    *,
    recordings: Path | None = None,
    truth: Path | None = None,
    html: Path | None = None,
    port: int | None = None,
    json: AsJson = False,
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
            the index, with the reports beside it.
        port: of the local server, which listens on this machine only; any free one by default.
        json: machine-readable: where the page is.
    """

    def opened(address: str) -> None:
        say_result(f"{address}   open this; Ctrl-C ends", {"address": address}, json=json)

    trajectories = [] if (artefact / "recording.json").exists() else sorted(artefact.glob("*.zarr"))
    if trajectories and html is None:
        return _serve_folder(trajectories, recordings, truth, port, opened)
    if trajectories:
        return _write_folder(trajectories, recordings, truth, html, json=json)
    page = ct.view(artefact, recordings, truth=truth, html=html, port=port, opened=opened)
    if page is not None:
        say_result(str(page), {"page": page}, json=json)
    return 0


def export(
    artefact: Positional[Path],
    *,
    output: Path,
    format: Literal["obj", "ply", "npz", "sheet", "mp4", "rrd"] | None = None,  # noqa: A002
    recordings: Path | None = None,
    truth: Path | None = None,
    rows: int = 6,
    json: AsJson = False,
) -> int:
    """Write a tracked trajectory in a format that other programs read, or as pictures for a paper.

    Args:
        artefact: NAME.zarr that `track` wrote.
        output: file, whose name says the format (.npz, .png, .mp4, .rrd), or folder (obj, ply: one
            file per frame).
        format: obj, ply or npz: the meshes; sheet: a contact sheet as PNG; mp4: the mesh over the
            observation; rrd: everything for Rerun's viewer, needs the extra [rerun]; what the
            output's name says by default, and obj where it says nothing.
        recordings: for sheet, mp4 and rrd: the recording, or the folder in which it lies by name.
        truth: for rrd: truth file, or the folder in which NAME.npz lie.
        rows: frames on the sheet.
        json: machine-readable.
    """
    from clothtrack.front.export_format import export_format

    kind = export_format(output, format)
    written = ct.export(ct.load(artefact, recordings), output, kind, rows=rows, truth=truth)
    say_result(str(written), {"written": written, "format": kind}, json=json)
    return 0


def _write_folder(
    trajectories: list[Path],
    recordings: Path | None,
    truth: Path | None,
    index: Path,
    *,
    json: bool,
) -> int:
    """Reports of all, and an index; a trajectory that cannot be shown is a line that says why."""
    from clothtrack.front.look import require_file_name
    from clothtrack.report.artefact_pages import write_index

    require_file_name(index)
    entries = []
    for done, path in enumerate(trajectories):
        progress(f"report of {path.stem}, {done + 1}/{len(trajectories)}", done, len(trajectories))
        entry, run = _entry(path, _required(recordings), index.parent)
        try:
            if run is not None and entry.page is not None:
                ct.write_report(run, entry.page, truth=truth)
        except ClothTrackError as error:
            entry = replace(entry, page=None, description=f"no report: {error}", verdicts="")
        entries.append(entry)
    page = write_index(entries, trajectories[0].parent.resolve().name, index)
    pages = [entry.page for entry in entries]
    say_result(str(page), {"page": page, "reports": pages}, json=json)
    return 1 if all(one is None for one in pages) else 0


def _serve_folder(
    trajectories: list[Path],
    recordings: Path | None,
    truth: Path | None,
    port: int | None,
    opened: Callable[[str], None],
) -> int:
    """An index and the reports, each written when somebody looks at it; the folder stays clean."""
    from clothtrack.evaluation.label_review import review_path
    from clothtrack.front.look import review_of
    from clothtrack.report.artefact_pages import write_index
    from clothtrack.report.live import Decisions, Report, serve_folder

    lie_in, title = _required(recordings), trajectories[0].parent.resolve().name

    def load() -> tuple[Callable[[Path], Path], dict[str, Report]]:
        entries, reports = [], {}
        for done, path in enumerate(trajectories):
            progress(f"read {path.stem}, {done + 1}/{len(trajectories)}", done, len(trajectories))
            entry, run = _entry(path, lie_in, path.parent)
            entries.append(entry)
            if run is not None:
                write = partial(ct.write_report, run, truth=truth)
                reports[path.stem] = Report(write, Decisions(review_of(run), review_path(path)))
        progress.clear()
        return partial(write_index, entries, title), reports

    serve_folder(title, load, port, opened=opened)
    return 0


def _required(recordings: Path | None) -> Path:
    if recordings is None:
        raise InvalidConfigError(
            "a tracked trajectory is looked at over its recording; add --recordings FOLDER"
        )
    return recordings


def _entry(path: Path, recordings: Path, folder: Path) -> "tuple[IndexEntry, Run | None]":
    """The line of a trajectory in an index, and the run where it can be read."""
    from clothtrack.front.look import review_of, summarised
    from clothtrack.report.artefact_pages import IndexEntry

    try:
        run = ct.load(path, recordings)
        verdicts = Counter(label.verdict for label in review_of(run).labels)
    except ClothTrackError as error:
        return IndexEntry(path.stem, None, f"no report: {error}"), None
    return IndexEntry(
        path.stem,
        folder / f"{path.stem}.html",
        f"{len(run.frames)} frames, {len(run.actions)} actions",
        ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items())),
        summarised(run),
    ), run
