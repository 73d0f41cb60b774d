"""Measure tracking of real cloth: three recorded sets, converted, tracked and scored.

Claim judged: the default mode follows real cloth, and better than the paper's own loss and than
the dynamics alone. No set has a true mesh, so each is judged by what it does have: a measured
surface and a print that must not slide (hanging-cloth-rgbd), clouds of two cameras
(robot-lift-fold-clouds), the true motion of one frame's pixels (tshirt-pair-rgbd). Chamfer
distances stand beside edge strain, because alone they reward a torn mesh. All but the T-shirt are
scored before the final alignment (TTO2).

    python experiments real_recordings --data DIR --json OUT

A set that is not in DIR is skipped. `--smoke` tracks a few frames without calibration, to see that
everything runs; its figures mean nothing.
"""

import argparse
import logging
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import _path  # noqa: F401

os.environ.setdefault("OMP_NUM_THREADS", "1")

from real import hanging_cloth, robot_clouds, tshirt_pair
from shared.figures import say, write_json
from shared.run_tracker import MODE_NAMES, before_final_alignment, track

from clothtrack.errors import ClothTrackError
from clothtrack.files.worker_pool import finished_in_workers
from clothtrack.geometry.devices import quiet_warp
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

COMPARED = MODE_NAMES
SMOKE_FRAMES = {hanging_cloth.NAME: 6, robot_clouds.NAME: 9}


@dataclass(frozen=True)
class Task:
    """One recording in one mode.

    Attributes:
        source: the set's folder or the sequence's file.
    """

    name: str
    source: Path
    recording: Path
    results: Path
    mode: str
    smoke: bool
    device: str

    def tracked(self) -> TrackedTrajectory:
        """Return the tracked trajectory of this task."""
        return track(
            self.recording, self.mode, self.results, calibrated=not self.smoke, device=self.device
        )


def score_hanging(task: Task) -> dict[str, object]:
    """Track and score the hanging cloth."""
    tracked = task.tracked()
    positions = before_final_alignment(tracked)
    return hanging_cloth.score(positions, tracked.mesh.faces, task.source).summary()


def score_robot(task: Task) -> dict[str, object]:
    """Track and score one lift or fold."""
    tracked = task.tracked()
    positions = before_final_alignment(tracked)
    return robot_clouds.score(
        positions, tracked.mesh.faces, task.source, rest=tracked.mesh
    ).summary()


def score_tshirt(task: Task) -> dict[str, object]:
    """Track and score the T-shirt's one step, as it is handed out and before TTO2."""
    tracked = task.tracked()
    faces = tracked.mesh.faces
    before = tshirt_pair.score(before_final_alignment(tracked), faces, task.source)
    after = tshirt_pair.score(tracked.positions, faces, task.source).summary()
    return after | {"before_final_alignment_mm": before.summary()["end_point_error_mm"]}


SCORERS: dict[str, Callable[[Task], dict[str, object]]] = {
    hanging_cloth.NAME: score_hanging,
    robot_clouds.NAME: score_robot,
    tshirt_pair.NAME: score_tshirt,
}


def attempt(task: Task) -> tuple[Task, dict[str, object]]:
    """Return a task and its figures, or the reason why there are none."""
    name = task.source.name if task.source.is_dir() else robot_clouds.NAME
    try:
        return task, SCORERS[name](task)
    except ClothTrackError as error:
        return task, {"error": str(error)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    options = parse(arguments)
    quiet_warp()
    logging.basicConfig(level=logging.INFO if options.verbose else logging.WARNING)
    report: dict[str, object] = {}
    with tempfile.TemporaryDirectory(prefix="real-recordings-") as temporary:
        keep = Path(temporary) if options.keep is None else options.keep
        for name in [options.only] if options.only else list(SCORERS):
            folder = options.data / name
            if not folder.is_dir():
                say(f"{name}: skipped, there is no {folder}\n")
                report[name] = {"skipped": f"there is no {folder}"}
                continue
            report[name] = judge(name, folder, keep, options)
            if options.json is not None:
                write_json(options.json, report)
    if options.json is not None:
        write_json(options.json, report)
    return 0


def judge(name: str, folder: Path, keep: Path, options: argparse.Namespace) -> dict[str, object]:
    """Convert, track and score one set in all wanted modes, and print its table."""
    modes = options.modes or (COMPARED if name == robot_clouds.NAME else ("default",))
    if options.smoke and not options.modes:
        modes = ("default",)
    tasks = [
        Task(recording.name, source, recording, keep / "tracked", mode, options.smoke,
             options.device)
        for recording, source in converted(name, folder, keep / "recordings", smoke=options.smoke)
        for mode in modes
    ]  # fmt: skip
    with closing(finished_in_workers(attempt, tasks, options.workers)) as made:
        scores = dict(made)
    rows = [{"sequence": task.name, "mode": task.mode, **scores[task]} for task in tasks]
    say(table(name, rows, smoke=options.smoke))
    return by_mode(rows, modes) if name == robot_clouds.NAME else head(rows)


def converted(name: str, folder: Path, output: Path, *, smoke: bool) -> list[tuple[Path, Path]]:
    """Write the set's recordings; each with the folder or file that its scorer reads.

    A recording that lies there from an earlier run with `--keep` is taken as it is.
    """
    frames = SMOKE_FRAMES.get(name) if smoke else None
    if name == robot_clouds.NAME:
        files = robot_clouds.sequences(folder)
        files = files[-1:] if smoke else files
        wanted = [(robot_clouds.convert, file, output / file.stem) for file in files]
    else:
        convert = hanging_cloth.convert if name == hanging_cloth.NAME else tshirt_pair.convert
        wanted = [(convert, folder, output / name)]
    return [
        (recording if recording.exists() else convert(source, recording, frames=frames), source)
        for convert, source, recording in wanted
    ]


def by_mode(rows: list[dict[str, object]], modes: Sequence[str]) -> dict[str, object]:
    """Return rows of the robot's sequences with their means (worst frame: maximum) by mode."""
    found = {mode: [r for r in rows if r["mode"] == mode and "error" not in r] for mode in modes}
    found = {mode: scored for mode, scored in found.items() if scored}

    def mean(key: str, task: str = "") -> dict[str, float]:
        chosen = {
            m: [r[key] for r in s if r["sequence"].startswith(task)] for m, s in found.items()
        }
        return {mode: sum(values) / len(values) for mode, values in chosen.items() if values}

    return {
        "rows": rows,
        "mean": mean("chamfer_pc_m2"),
        "mean_lift": mean("chamfer_pc_m2", "lift"),
        "mean_fold": mean("chamfer_pc_m2", "fold"),
        "median": mean("median_m2"),
        "worst_frame": {m: max(r["worst_frame_m2"] for r in s) for m, s in found.items()},
        "edge_strain": mean("edge_strain"),
        "default_mode": "default" if "default" in modes else modes[0],
    }


def head(rows: list[dict[str, object]]) -> dict[str, object]:
    """Return the figures of the first mode, with all modes beside them."""
    figures = {
        r["mode"]: {k: v for k, v in r.items() if k not in ("mode", "sequence")} for r in rows
    }
    first = rows[0]["mode"]
    return {**figures[first], "mode": first, "modes": figures}


HEADINGS = {
    hanging_cloth.NAME: "real recording, 1e-4 m^2 against the measured points, before TTO2",
    robot_clouds.NAME: "real recordings, 1e-4 m^2 against the clouds above the cut, before TTO2",
    tshirt_pair.NAME: "real recording, motion of the first frame's pixels, after TTO2",
}
COLUMNS: dict[str, tuple[tuple[str, str, float], ...]] = {
    hanging_cloth.NAME: (
        ("chamfer_surface_m2", "mean", 1e4),
        ("worst_frame_m2", "worst frame", 1e4),
        ("edge_strain", "strain %", 1e2),
        ("pattern_drift_mm", "drift mm", 1.0),
        ("pattern_matched", "matched %", 1e2),
    ),
    robot_clouds.NAME: (
        ("chamfer_pc_m2", "mean", 1e4),
        ("median_m2", "median", 1e4),
        ("worst_frame_m2", "worst frame", 1e4),
        ("cloud_to_mesh_m2", "cloud->mesh", 1e4),
        ("band_as_target_m2", "band met", 1e4),
        ("band_as_target_worst_m2", "its worst", 1e4),
        ("edge_strain", "strain %", 1e2),
    ),
    tshirt_pair.NAME: (
        ("end_point_error_mm", "mean mm", 1.0),
        ("median_mm", "median mm", 1.0),
        ("p95_mm", "95 % mm", 1.0),
        ("before_final_alignment_mm", "before TTO2", 1.0),
    ),
}


def table(name: str, rows: list[dict[str, object]], *, smoke: bool = False) -> str:
    """Return the set's figures as text, one line per sequence and mode, and means of several."""
    note = " (smoke run: a few frames, not calibrated)" if smoke else ""
    lines = [f"{name}: {HEADINGS[name]}{note}"]
    titles = "".join(f"{title:>13}" for _, title, _ in COLUMNS[name])
    lines.append(f"{'sequence':<22}{'mode':<28}{titles}")
    for row in [*rows, *_means(name, rows)]:
        figures = row.get("error") or "".join(
            f"{'lost':>13}" if row[key] is None else f"{row[key] * scale:13.2f}"
            for key, _, scale in COLUMNS[name]
        )
        lines.append(f"{row['sequence']:<22}{row['mode']:<28}{figures}")
    return "\n".join(lines) + "\n\n"


def _means(name: str, rows: list[dict[str, object]]) -> list[dict[str, object]]:
    good = [row for row in rows if "error" not in row]
    means = []
    for mode in dict.fromkeys(row["mode"] for row in good):
        of_mode = [row for row in good if row["mode"] == mode]
        if len(of_mode) > 1:
            mean = {k: sum(r[k] for r in of_mode) / len(of_mode) for k, _, _ in COLUMNS[name]}
            means.append({"sequence": f"mean of {len(of_mode)}", "mode": mode, **mean})
    return means


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder that holds the sets")
    parser.add_argument("--only", choices=list(SCORERS), help="one set")
    parser.add_argument("--modes", nargs="+", choices=MODE_NAMES, help="modes of the tracker")
    parser.add_argument("--keep", type=Path, help="keep recordings and tracked results here")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--smoke", action="store_true", help="a few frames, under a minute")
    parser.add_argument("--verbose", action="store_true", help="log what happens")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
