"""How far tracked vertices are from the truth, in the stand-in world.

Claim judged: with an action, dynamics and the cloud together the hidden part of the cloth is
tracked better than by the dynamics alone (open loop), after one, two and three pick-and-places.
The world is another engine than the tracker's (a MuJoCo flex shell), with a noisy depth camera and
a tool in the way; its truth lies in a folder that only the evaluation reads. 4 towels and 4
T-shirts, about 1,500 tracker vertices. The Chamfer distance stands beside its floor (what the
truth itself scores), because alone it does not rank methods.

    python experiments/world_tracking.py --world OUT --json FILE

OUT is what `clothtrack simulate OUT` leaves (`recordings/` and `truth/`); a world that is missing
is simulated first. `--smoke` films and tracks one small towel for one action.
"""

import argparse
import logging
import os
import sys
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from figures import say, write_json
from run_tracker import MODE_NAMES, track

from clothtrack.errors import ClothTrackError
from clothtrack.evaluation.results import evaluate
from clothtrack.evaluation.truth import Truth
from clothtrack.geometry.devices import quiet_warp
from clothtrack.recordings.store import read_recording
from clothtrack.world.episodes import EpisodeConfig, TemplateConfig, simulate

KINDS = ("towel", "tshirt")
COMPARED = ("default", "full_held_paper", "open_loop")
STAGES = {"before": "before_final_alignment", "after": "after_final_alignment"}
REGIONS = ("all", "visible", "hidden")
SMOKE_CONFIG = EpisodeConfig(
    vertex_count=250, actions=1, template=TemplateConfig(vertex_count=300), size_m=(0.2, 0.2)
)


@dataclass(frozen=True)
class Task:
    """One recording of the world in one mode.

    Attributes:
        recording: its folder.
        truth: the file with its truth.
        results: where tracked results go.
        mode: the tracker's mode.
        smoke: skip calibration.
        device: "cpu" or "cuda:0".
    """

    recording: Path
    truth: Path
    results: Path
    mode: str
    smoke: bool
    device: str


def rows_of(task: Task) -> list[dict[str, object]]:
    """Track and measure one recording; a row per action and stage, or one with the reason why not.

    Vertex errors are means [mm]; Chamfer distances are squared means [m^2], both directions.
    """
    name = {"recording": task.recording.name, "mode": task.mode}
    try:
        tracked = track(
            task.recording,
            task.mode,
            task.results,
            calibrated=not task.smoke,
            device=task.device,
        )
        measured = evaluate(tracked, read_recording(task.recording), Truth.load(task.truth))
    except ClothTrackError as error:
        return [{**name, "error": str(error)}]
    return [
        {
            **name,
            "action": row.action + 1,
            "stage": row.stage,
            **{f"error_{part}_mm": row.vertex_error_mm[part].mean for part in REGIONS},
            "error_p95_mm": row.vertex_error_mm["all"].p95,
            "chamfer_pc_m2": row.chamfer_pc,
            "chamfer_floor_m2": row.chamfer_floor,
            "edge_strain": row.cloth.edge_strain,
            "crossings": row.cloth.crossings,
            "close_pairs": row.cloth.close_pairs,
            "below_table": row.cloth.below_table,
        }
        for row in measured.rows
    ]


def summarise(rows: Iterable[dict[str, object]], modes: Sequence[str]) -> list[dict[str, object]]:
    """Means per mode, stage, kind and action (None: all of several), paired with open loop.

    `against_open_loop_mm` is the mean difference of the error over all vertices on the same
    recordings and actions, `better_than_open_loop` in how many of the pairs it is negative.
    """
    good = [row for row in rows if "error" not in row]
    open_loop = {
        (row["recording"], row["action"]): row["error_all_mm"]
        for row in good
        if row["mode"] == "open_loop" and row["stage"] == STAGES["before"]
    }
    actions = sorted({row["action"] for row in good})
    kinds = [kind for kind in KINDS if any(row["recording"].startswith(kind) for row in good)]
    summary = []
    for mode in modes:
        for stage in STAGES.values():
            for kind in (*kinds, None) if len(kinds) > 1 else kinds:
                for action in (*actions, None) if len(actions) > 1 else actions:
                    chosen = [
                        row
                        for row in good
                        if (row["mode"], row["stage"]) == (mode, stage)
                        and row["recording"].startswith(kind or "")
                        and action in (row["action"], None)
                    ]
                    if chosen:
                        label = {"mode": mode, "stage": stage, "kind": kind, "action": action}
                        summary.append(label | _means(chosen) | _paired(chosen, open_loop))
    return summary


def _means(rows: list[dict[str, object]]) -> dict[str, object]:
    skipped = ("recording", "mode", "stage", "action")
    keys = [key for key in rows[0] if key not in skipped]
    means: dict[str, object] = {"meshes": len(rows)}
    for key in keys:
        values = np.array([row[key] for row in rows], dtype=float)
        known = values[np.isfinite(values)]
        means[key] = float(known.mean()) if len(known) else None
    return means


def _paired(
    rows: list[dict[str, object]], open_loop: dict[tuple[object, object], float]
) -> dict[str, object]:
    gaps = np.array(
        [
            row["error_all_mm"] - open_loop[row["recording"], row["action"]]
            for row in rows
            if (row["recording"], row["action"]) in open_loop
        ]
    )
    if len(gaps) == 0:
        return {}
    return {
        "against_open_loop_mm": float(gaps.mean()),
        "better_than_open_loop": int((gaps < 0).sum()),
        "pairs": len(gaps),
    }


def table(summary: list[dict[str, object]]) -> str:
    """The summary as text, one line per mode, stage, kind and action."""
    titles = ("all mm", "visible", "hidden", "p95", "PC 1e-4", "floor", "strain %", "crossings")
    keys = (
        *(f"error_{part}_mm" for part in REGIONS),
        "error_p95_mm",
        "chamfer_pc_m2",
        "chamfer_floor_m2",
        "edge_strain",
        "crossings",
    )
    scales = (1, 1, 1, 1, 1e4, 1e4, 1e2, 1)
    heading = f"{'mode':<28}{'TTO2':<8}{'garment':<9}{'action':<8}"
    lines = [heading + "".join(f"{title:>10}" for title in titles) + "  against open loop"]
    short = {stage: name for name, stage in STAGES.items()}
    for row in summary:
        figures = "".join(
            f"{'-':>10}" if row[key] is None else f"{row[key] * scale:10.2f}"
            for key, scale in zip(keys, scales, strict=True)
        )
        paired = ""
        if "pairs" in row:
            gap, better = row["against_open_loop_mm"], row["better_than_open_loop"]
            paired = f"  {gap:+.2f} mm, better in {better} of {row['pairs']}"
        lines.append(
            f"{row['mode']:<28}{short[row['stage']]:<8}{row['kind'] or 'both':<9}"
            f"{row['action'] or 'all'!s:<8}{figures}{paired}"
        )
    return "\n".join(lines) + "\n"


def world_recordings(options: argparse.Namespace, out: Path) -> list[tuple[Path, Path]]:
    """The world's recordings with their truths; simulated first where they are missing."""
    folders = []
    for kind in KINDS[:1] if options.smoke else KINDS:
        count = 1 if options.smoke else options.trajectories
        found = sorted((out / "recordings").glob(f"{kind}_*"))[:count]
        if len(found) < count:
            config = SMOKE_CONFIG if options.smoke else None
            found = simulate(
                out, kind, count, seed=options.seed, config=config, processes=options.workers
            )
        folders += found
    return [(folder, out / "truth" / f"{folder.name}.npz") for folder in folders]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    options = parse(arguments)
    quiet_warp()
    logging.basicConfig(level=logging.INFO if options.verbose else logging.WARNING)
    with tempfile.TemporaryDirectory(prefix="world-tracking-") as temporary:
        # A smoke run leaves nothing in a world that is kept.
        out = Path(temporary) if options.smoke or options.world is None else options.world
        tasks = [
            Task(recording, truth, out / "tracked", mode, options.smoke, options.device)
            for recording, truth in world_recordings(options, out)
            for mode in options.modes
        ]
        if options.workers > 1:
            with ProcessPoolExecutor(options.workers, get_context("spawn"), quiet_warp) as pool:
                parts = list(pool.map(rows_of, tasks))
        else:
            parts = [rows_of(task) for task in tasks]
    rows = [row for part in parts for row in part]
    summary = summarise(rows, options.modes)
    names = ", ".join(dict.fromkeys(task.recording.name for task in tasks))
    note = " (smoke run: one small towel, not calibrated)" if options.smoke else ""
    say(f"Stand-in world (MuJoCo flex), true vertex errors: {names}{note}\n")
    say(table(summary))
    for row in rows:
        if "error" in row:
            say(f"{row['recording']}, {row['mode']}: {row['error']}\n")
    if options.json is not None:
        write_json(options.json, {"rows": rows, "summary": summary, "default_mode": "default"})
    return 1 if all("error" in row for row in rows) else 0


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", type=Path, help="folder of `clothtrack simulate`; kept")
    parser.add_argument("--modes", nargs="+", choices=MODE_NAMES, default=list(COMPARED))
    parser.add_argument("--trajectories", type=int, default=4, help="per kind of garment")
    parser.add_argument("--seed", type=int, default=0, help="of the first trajectory")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--smoke", action="store_true", help="one small towel, under a minute")
    parser.add_argument("--verbose", action="store_true", help="log what happens")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
