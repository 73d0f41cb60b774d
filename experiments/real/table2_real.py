"""Table 2 on real cloth: a network before and after it learned from labels of tracked napkins.

Claim judged: pseudo-labels of a real garment teach a network that was pretrained in simulation to
see that garment: Chamfer PC 60 % lower than before and 30 % lower than after as many simulated
pictures of the same lifts, Chamfer Mesh 45 % lower, the corner that the gripper holds within 50 mm
of the gripper. The network is never given the position of the gripper.

    python experiments table2_real --data DIR [--test DIR] --json OUT

DIR has robot-lift-fold-clouds: eight sequences are learned from, two are there to choose by, and
those of --test are only measured on. If it has hanging-cloth-rgbd too, 15 of that cloth's frames
are measured after others were learned from, the late, the middle and the early ones in turn, by the
token network alone: the published one knows no cloth so large. `--only` takes one of the sets.
Recordings, tracked meshes, labels, tuned weights and rows are kept in a folder beside OUT that is
called like it, so that a second call scores at once. Weights that learned from data without a
license are not to be passed on. `--smoke` learns one epoch from drawn clouds; its figures mean
nothing.
"""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import _path  # noqa: F401

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from shared.bench_measures import Row, finite
from shared.bench_runs import read_rows, write_rows
from shared.figures import say, write_json
from shared.learning_runs import Tuner, content_digest, tiny_network
from shared.run_tracker import track

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.files.provenance import commit
from clothtrack.files.worker_pool import finished_in_workers
from clothtrack.geometry.devices import quiet_warp
from clothtrack.reconstruction.availability import SHIPPED
from clothtrack.reconstruction.data.pseudo_labels import (
    LabeledRecording,
    read_labels,
    write_labels,
)
from clothtrack.reconstruction.model_loading import load_model
from clothtrack.reconstruction.training.checkpoint import load_weights
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory
from clothtrack_lab.published_networks.registered import SHIPPED as PUBLISHED
from real import hanging_cloth
from real.drawn_sets import TABLE_M, write_robot_clouds
from real.hanging_learning import hanging_frames
from real.learned_cloth import KIND, Answer, Ask, Cloth
from real.robot_learning import TO_CHOOSE, napkins, refuse_shared

NETWORKS = {
    "tokens": SHIPPED / "tokens.safetensors",
    "published": PUBLISHED / f"{KIND}.safetensors",
}
"""Shipped weights of each network."""
NAPKINS, HANGING = "napkins", "hanging"
NONE, CONTROL, TRACKER = "none", "simulated_control", "tracker"
JOINED = "default_and_simulated"
"""Labels of the default tracker and the control's pictures, learned from together."""
MODES = ("open_loop", "paper", "default")
LABELS = (NONE, *MODES, CONTROL, JOINED)
UNTUNED = "untuned"
"""The control's dynamics: along the path with the cloth's parameters as they come."""

MEASURES = (
    "chamfer_pc_m2", "band_as_target_m2", "chamfer_mesh_m2", "corner_mm", "edge_strain",
    "crossings_per_1000_edges", "second_camera_mm", "print_matched", "print_slide_mm",
)  # fmt: skip
ROW_FORMAT = 1
"""Raise it when a measure changes its meaning: kept rows are then made anew."""

SMOKE_SEQUENCES = ("lift_white", "lift_grey", TO_CHOOSE[0])
SMOKE_SETTINGS = (
    "canonicalisation.epochs=1", "completion.epochs=1", "tokens.epochs=1",
    "examples.winding.pool=1024", "examples.surface_queries=64", "examples.volume_queries=64",
)  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """All inputs of the rows.

    Attributes:
        splits: recordings for training, "train", and for measuring: "choose", "test".
        starts: initial weights of the networks, by name.
        calibrated: False leaves the trackers' calibration out (smoke runs).
    """

    keep: Path
    splits: Mapping[str, Sequence[Cloth]]
    starts: Mapping[str, Path]
    tuner: Tuner
    calibrated: bool = True
    workers: int = 1

    def tracked(self, cloth: Cloth, mode: str) -> TrackedTrajectory:
        """Return the tracked recording; tracked where it is not kept."""
        told = mode != UNTUNED
        return track(
            cloth.folder,
            mode if told else "open_loop",
            self.keep / ("tracked" if told else UNTUNED),
            calibrated=told and self.calibrated,
        )

    def labels(self, name: str) -> list[LabeledRecording]:
        """Return what is learned from, by name; made where it is not kept."""
        if name == JOINED:
            return [*self.labels("default"), *self.labels(CONTROL)]
        found = []
        for cloth in self.splits["train"]:
            file = self.keep / "labels" / name / f"{cloth.name}.npz"
            if not file.exists():
                file.parent.mkdir(parents=True, exist_ok=True)
                write_labels(self._labeled(cloth, name), file)
            found.append(read_labels(file))
            _progress(f"labels {name}, {cloth.name}: {len(found[-1].pictures)} pictures\n")
        return [one for one in found if one.pictures]

    def _labeled(self, cloth: Cloth, name: str) -> LabeledRecording:
        if name == CONTROL:
            return cloth.simulated(self.tracked(cloth, UNTUNED))
        return cloth.labeled(self.tracked(cloth, name))

    def all_pictures(self, cloths: Sequence[Cloth], weights: Path | None) -> list[Row]:
        """Return the rows of several recordings, in their order."""
        measure = partial(self.pictures, weights=weights)
        with closing(finished_in_workers(measure, cloths, self.workers)) as made:
            rows = [row for some in made for row in some]
        order = {cloth.name: number for number, cloth in enumerate(cloths)}
        return sorted(rows, key=lambda row: order[row["sequence"]])

    def pictures(self, cloth: Cloth, weights: Path | None) -> list[Row]:
        """Return a row per picture of a recording, by a network or, without one, by the tracker."""
        key = TRACKER if weights is None else content_digest(weights)
        file = self.keep / "rows" / f"{cloth.name}-{key}-{ROW_FORMAT}.jsonl"
        if not file.exists():
            tracked = self.tracked(cloth, "default")
            ask = cloth.tracked_mesh(tracked) if weights is None else _network(cloth, weights)
            rows = []
            for frame in cloth.frames:
                mesh, rest = ask(frame)
                row: Row = {"sequence": cloth.name, "frame": frame}
                if mesh is not None and rest is not None:
                    row |= cloth.judged(frame, mesh, rest, tracked)
                rows.append(finite(row))
            write_rows(rows, file)
            _progress(f"{key}, {cloth.name}: measured\n")
        return read_rows(file)


def _network(cloth: Cloth, weights: Path) -> Ask:
    model = load_model(KIND, weights)

    def ask(frame: int) -> Answer:
        found = model.mesh(cloth.picture(frame), KIND, size_m=cloth.size_m)
        return found.mesh, found.reconstruction.rest

    return ask


def run(napkin_plan: Plan, options: argparse.Namespace) -> dict[str, Any]:
    """Return every row of both sets; the report is written after each of them."""
    report: dict[str, Any] = {"provenance": _stamp(napkin_plan)}
    if options.only != HANGING:
        report["rows"] = rows = []
        for row in rows_of(napkin_plan, options.labels):
            rows.append(row)
            write_json(options.json, report)
    if options.smoke or options.only == NAPKINS or "tokens" not in napkin_plan.starts:
        return report
    starts = {"tokens": napkin_plan.starts["tokens"]}
    hanging = hanging_frames(options.data, napkin_plan.keep / "recordings")
    if options.only == HANGING and not hanging:
        raise InvalidConfigError(f"{options.data}: there is no {hanging_cloth.NAME} in it")
    for splits in hanging.values():
        plan = replace(napkin_plan, splits=splits, starts=starts)
        rows = report.setdefault(HANGING, {"rows": []})["rows"]
        for row in rows_of(plan, options.labels):
            rows.append(row)
            write_json(options.json, report)
    return report


def rows_of(plan: Plan, labels: Sequence[str]) -> Iterator[Row]:
    """Yield the rows of every network, one set of labels after the other, and of the tracker."""
    for network, start in plan.starts.items():
        for name in labels:
            try:
                learned = [] if name == NONE else plan.labels(name)
                weights = start if name == NONE else plan.tuner.tuned(start, learned)
                count = sum(len(one.pictures) for one in learned)
                said = {"learned_pictures": count, "weights": _kept_name(plan, weights)}
                for row in _split_rows(plan, weights):
                    yield {**_named(network, name), **said, **row}
            except ClothTrackError as error:
                yield {**_named(network, name), "error": str(error)}
        for row in _split_rows(plan, None):
            yield {**_named(network, TRACKER), **row}


def _named(network: str, labels: str) -> Row:
    return {"network": network, "labels": labels, "learned_pictures": 0}


def _kept_name(plan: Plan, weights: Path) -> str:
    """Return the path of the weights in the kept folder, or the name of shipped ones."""
    inside = weights.is_relative_to(plan.keep)
    return weights.relative_to(plan.keep).as_posix() if inside else weights.name


def _split_rows(plan: Plan, weights: Path | None) -> list[Row]:
    found = []
    for split, sequences in plan.splits.items():
        if split == "train":
            continue
        pictures = plan.all_pictures(sequences, weights)
        row: Row = {
            "split": split,
            "pictures": len(pictures), "sequences": len(sequences),
            "without_mesh": sum("chamfer_pc_m2" not in one for one in pictures),
        }  # fmt: skip
        for name in MEASURES:
            row |= _statistics(name, pictures)
        found.append(row)
    return found


def _statistics(name: str, pictures: Sequence[Row]) -> Row:
    """Return mean and median over pictures, and the standard error over sequences."""
    values = [one[name] for one in pictures if one.get(name) is not None]
    own: dict[str, list[float]] = {}
    for one in pictures:
        if one.get(name) is not None:
            own.setdefault(one["sequence"], []).append(one[name])
    means = [float(np.mean(each)) for each in own.values()]
    several = len(means) > 1
    return {
        name: float(np.mean(values)) if values else None,
        f"{name}_median": float(np.median(values)) if values else None,
        f"{name}_standard_error": np.std(means, ddof=1) / np.sqrt(len(means)) if several else None,
    }


def _stamp(plan: Plan) -> dict[str, object]:
    return {
        "commit": commit(),
        "world": "real: robot-lift-fold-clouds, hanging-cloth-rgbd",
        "training": {
            name: json.loads(
                json.dumps(asdict(plan.tuner.config_of(load_weights(path))), default=str)
            )
            for name, path in plan.starts.items()
        },
        "sequences": {name: [one.name for one in own] for name, own in plan.splits.items()},
    }


COLUMNS = (
    ("chamfer_pc_m2", "Chamfer PC", 1e4), ("chamfer_pc_m2_median", "median", 1e4),
    ("chamfer_pc_m2_standard_error", "s.e.", 1e4), ("band_as_target_m2", "band met", 1e4),
    ("chamfer_mesh_m2", "Chamfer Mesh", 1e4),
    ("corner_mm", "corner mm", 1.0), ("corner_mm_standard_error", "s.e.", 1.0),
    ("second_camera_mm", "2nd camera mm", 1.0), ("edge_strain", "strain %", 1e2),
    ("crossings_per_1000_edges", "crossings", 1.0), ("print_matched", "print %", 1e2),
)  # fmt: skip


def table(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table; Chamfer in 1e-4 m^2."""
    heads = ["network", "labels", "split", "learned", "judged", *(head for _, head, _ in COLUMNS)]
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    for row in rows:
        if "error" in row:
            lines.append(f"| {row['network']} | {row['labels']} | {row['error']} |")
            continue
        cells = [str(row[key]) for key in ("network", "labels", "split", "learned_pictures")]
        cells.append(str(row["pictures"]))
        for key, _, factor in COLUMNS:
            value = row[key]
            cells.append("-" if value is None else f"{factor * value:.2f}")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    options = parse(arguments)
    quiet_warp()
    with tempfile.TemporaryDirectory(prefix="table2-real-") as temporary:
        try:
            plan = smoke(options, Path(temporary)) if options.smoke else planned(options)
            report = run(plan, options)
        except ClothTrackError as error:
            sys.stderr.write(f"{error}\n")
            return 1
    if options.smoke:
        say("Smoke run: drawn clouds, one epoch; no result.\n\n")
    say(f"{__doc__.splitlines()[0]}\n")
    if "rows" in report:
        say(f"\n{table(report['rows'])}")
    if HANGING in report:
        say(f"\nhanging-cloth-rgbd\n\n{table(report[HANGING]['rows'])}")
    return 0


def planned(options: argparse.Namespace) -> Plan:
    """Return the plan that the command line asks for."""
    keep = options.json.with_suffix("")
    found = napkins(options.data, keep / "recordings")
    splits = {
        "train": [one for one in found if one.name not in TO_CHOOSE],
        "choose": [one for one in found if one.name in TO_CHOOSE],
    }
    if options.test is not None:
        splits["test"] = napkins(options.test, keep / "recordings_to_test")
    for name, sequences in splits.items():
        if not sequences:
            raise InvalidConfigError(
                f"{options.data}: no sequence is there for {name!r}; {', '.join(TO_CHOOSE)} are "
                "to choose by, the others are learned from"
            )
        if name != "train":
            refuse_shared(splits["train"], sequences)
    starts = {name: NETWORKS[name] for name in options.networks}
    # One sequence of the eight selects the best weights.
    tuner = Tuner(keep / "networks", options.training, tuple(options.settings), held_out_share=0.13)
    return Plan(keep, splits, starts, tuner, workers=options.workers)


def smoke(options: argparse.Namespace, temporary: Path) -> Plan:
    """Return drawn clouds, and a published network that has learned nothing."""
    options.data = write_robot_clouds(temporary / "data", SMOKE_SEQUENCES, lowest_z_m=TABLE_M)
    options.json = options.json or temporary / "rows.json"
    options.settings = [*SMOKE_SETTINGS, *options.settings]
    plan = planned(options)
    tiny = tiny_network(plan.keep / f"{KIND}.safetensors", KIND)
    starts = {n: tiny if n == "published" else file for n, file in plan.starts.items()}
    return replace(plan, starts=starts, calibrated=False)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder that holds the set")
    parser.add_argument("--test", type=Path, help="sequences that are only measured on")
    parser.add_argument("--json", type=Path, help="rows; all else lies beside it")
    parser.add_argument(
        "--networks", nargs="+", choices=list(NETWORKS), default=list(NETWORKS), help="both"
    )
    parser.add_argument("--labels", nargs="+", choices=LABELS, default=LABELS, help="all of them")
    parser.add_argument("--only", choices=(NAPKINS, HANGING), help="both")
    presets = ("finetune", "finetune_short", "paper")
    parser.add_argument("--training", choices=presets, default="finetune_short", help="how")
    parser.add_argument("--set", dest="settings", action="append", default=[], help="a setting")
    parser.add_argument("--workers", type=int, default=1, help="processes that measure")
    parser.add_argument("--smoke", action="store_true", help="drawn clouds, one epoch")
    options = parser.parse_args(arguments)
    if not options.smoke and (options.data is None or options.json is None):
        parser.error("give --data DIR and --json OUT, or --smoke")
    if options.only == HANGING and (options.smoke or "tokens" not in options.networks):
        parser.error("--only hanging is for real data and the token network")
    return options


def _progress(text: str) -> None:
    sys.stderr.write(text)
    sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
