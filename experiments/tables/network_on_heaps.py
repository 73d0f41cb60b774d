"""Measure networks on the pictures of flattening: the error of the mesh that planning starts from.

Each network reconstructs every few pictures that the episodes of `flattening.py` took in the
simulated world, for any policy. The meshes are fine-tuned to the picture as in an episode and
compared with the true cloth. The benchmark has folds of lying cloth; these pictures show heaps,
before and after pulls. Claim judged: a network trained on cloth being pulled apart has a smaller
error there.

    python experiments network_on_heaps --out OUT --kind tshirt --weights FILE FILE --every 4

OUT is that of `flattening.py`. Means are over starts, each the mean of its pictures.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from shared.bench_measures import Row, finite
from shared.bench_runs import write_rows
from shared.figures import say
from shared.learning_measures import Case, vertex_errors
from shared.table_column import Column, paired, table
from shared.tables import SYMMETRIC

from clothtrack import __version__
from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.evaluation.metrics import chamfer_pc
from clothtrack.evaluation.truth import Truth
from clothtrack.files.atomic_write import content_hash
from clothtrack.files.provenance import commit
from clothtrack.files.worker_pool import finished_in_workers
from clothtrack.geometry.devices import quiet_warp
from clothtrack.geometry.visibility import visible_vertices
from clothtrack.planning.episode_store import EpisodeStore
from clothtrack.planning.perception import Estimate, NetworkPerception, PerceptionConfig
from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.store import read_recording

NAME = "network_on_heaps"
COVERAGES = (0.0, 0.55, 0.7, 0.85, np.inf)
"""Bounds of the bands of true coverage in which errors are told."""

SYMMETRIC_VISIBLE = Column("visible", "error_symmetric_visible_mm")
SYMMETRIC_HIDDEN = Column("hidden", "error_symmetric_hidden_mm")
CHAMFER = Column("Chamfer PC, 1e-4 m2", "chamfer_pc_m2", 1e4, 2)


@dataclass(frozen=True)
class Task:
    """The pictures of one episode, seen by one network."""

    weights: Path
    episode: Path
    steps: tuple[int, ...]
    kind: str


def tasks_of(out: Path, kind: str, weights: Sequence[Path], every: int) -> list[Task]:
    """Return every so many pictures of all finished episodes; a start's first picture once."""
    found: list[tuple[Path, tuple[int, ...]]] = []
    begun: set[str] = set()
    number = 0
    for document in sorted(out.glob(f"flattening/*/episodes/{kind}_*/episode.json")):
        episode = json.loads(document.read_text(encoding="utf-8"))
        folder, chosen = document.parent, []
        if episode["status"] == "running":
            continue
        first = 1 if folder.name in begun else 0
        for step in range(first, len(episode["steps"])):
            chosen += [step] if number % every == 0 else []
            number += 1
        begun.add(folder.name)
        found.append((folder, tuple(chosen)))
    if not number:
        raise InvalidConfigError(
            f"{out}: no finished episode of a {kind} is there; flatten some with flattening.py"
        )
    return [Task(one, *each, kind) for one in weights for each in found if each[1]]


def run(task: Task) -> list[Row]:
    """Return one row per picture."""
    quiet_warp()
    network = NetworkPerception(task.kind, PerceptionConfig(weights=str(task.weights)))
    asked = json.loads((task.episode / "episode.json").read_text(encoding="utf-8"))["asked"]
    store, name = EpisodeStore(task.episode, asked), task.episode.name
    runs = task.episode.parents[1]
    recording = read_recording(runs / "recordings" / name)
    truth = Truth.load(runs / "truth" / f"{name}.npz")
    rows: list[Row] = []
    for step in task.steps:
        named = {
            "experiment": NAME, "variant": str(task.weights), "recording": name,
            "kind": task.kind, "split": "", "policy": asked["config"]["policy"], "action": step,
            "stage": "after", "coverage": store.steps[step]["true_m2"] / store.steps[0]["flat_m2"],
            "provenance": {
                "clothtrack": __version__, "commit": commit(),
                "weights_sha256": content_hash(task.weights),
            },
        }  # fmt: skip
        try:
            estimate = network.perceive(read_recording(store.recording_path(step)))
        except ClothTrackError as error:
            rows.append({**named, "error": str(error)})
            continue
        case = Case(recording, truth, int(truth.frames[step]), task.kind)
        # Nothing may be hidden, or nothing seen: what is not measured is left out of the means.
        found = measured(estimate, case)
        rows.append({**named, **{key: finite(value) for key, value in found.items()}})
    return rows


def measured(estimate: Estimate, case: Case) -> Row:
    """Return a mesh against cloud and truth."""
    mesh = replace(estimate.flat, vertices=estimate.positions)
    _, best = vertex_errors(mesh, case)
    cloud = observe(case.recording, case.recording.frames[case.frame]).points
    seen = visible_vertices(estimate.positions, mesh.faces, case.recording.cameras)
    return {
        "chamfer_pc_m2": chamfer_pc(estimate.positions, seen, cloud),
        "error_symmetric_mm": best["all"].mean,
        "error_symmetric_visible_mm": best["visible"].mean,
        "error_symmetric_hidden_mm": best["hidden"].mean,
    }


def markdown(rows: Sequence[Row]) -> str:
    """Return one line per network; the difference is to the first, over starts."""
    head = ["network", "pictures", "error up to symmetry, mm", "median picture", "visible",
            "hidden", CHAMFER.title, "minus the first", "lower in"]  # fmt: skip
    bands = list(pairwise(COVERAGES))
    head += [f"coverage {100 * low:.0f} to {100 * min(high, 1.0):.0f} %" for low, high in bands]
    networks = list(dict.fromkeys(str(row["variant"]) for row in rows))
    good = {one: [row for row in rows if row["variant"] == one and "error" not in row]
            for one in networks}  # fmt: skip
    first = SYMMETRIC.values(good[networks[0]])
    lines = []
    for network, own in good.items():
        means = SYMMETRIC.values(own)
        values = np.array(list(means.values()))
        gaps = np.array([means[name] - first[name] for name in means if name in first])
        pair = ["", ""] if network == networks[0] else paired(gaps)
        deviation = f" ± {values.std(ddof=1):.1f}" if len(values) > 1 else ""
        line = [
            network, str(len(own)), f"{values.mean():.1f}{deviation}",
            f"{np.median([row[SYMMETRIC.key] for row in own]):.1f}",
            *(cell for column in (SYMMETRIC_VISIBLE, SYMMETRIC_HIDDEN, CHAMFER)
              for cell in column.cells(own)),
            *pair,
        ]  # fmt: skip
        for low, high in bands:
            inside = [row[SYMMETRIC.key] for row in own if low <= row["coverage"] < high]
            line.append(f"{np.mean(inside):.1f} ({len(inside)})" if inside else "-")
        lines.append(line)
    failed = [row for row in rows if "error" in row]
    text = [f"- {row['variant']}, {row['recording']}: {row['error']}" for row in failed]
    return "\n".join([table(head, lines), "", *text])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the episodes")
    parser.add_argument("--kind", default="tshirt", choices=("towel", "tshirt"))
    parser.add_argument("--weights", type=Path, nargs="+", required=True, help="of the networks")
    parser.add_argument("--every", type=int, default=4, help="so many pictures, one of them")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    options = parser.parse_args(arguments)
    if options.every < 1:
        parser.error("--every is at least 1")
    quiet_warp()
    try:
        tasks = tasks_of(options.out, options.kind, options.weights, options.every)
        rows: list[Row] = []
        for number, part in enumerate(finished_in_workers(run, tasks, options.workers), start=1):
            rows += part
            sys.stderr.write(f"{part[0]['recording']}: {number} of {len(tasks)}\n")
            rows.sort(key=lambda row: options.weights.index(Path(row["variant"])))
            write_rows(rows, options.out / f"{NAME}.jsonl")
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    say(f"{__doc__.splitlines()[0]}\n\n{options.kind}\n\n{markdown(rows)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
