"""Which belief to plan from, and to learn from: the network's, or the tracker's, over real actions.

Every picture that the episodes of `flattening.py` took in the stand-in world is believed in several
ways: by the network alone (what those episodes planned from), by the tracker that follows the last
action from the network's mesh before it, by the tracker that follows every action from the first
mesh, by whichever of the first and the last lies nearer to its cloud, which needs no truth, and by
the tracker that goes backwards from the network's mesh of the last picture: no belief to plan from,
but labels (`experiments improve`). Only errors are measured here; what a belief is worth to a
planner, `flattening.py` tells.

    python experiments flattening --out OUT --kind tshirt --film --only pretrained --weights FILE
    python experiments planning_perception --out OUT --kind tshirt

A tracker needs pictures of the actions: without `--film` every picture is perceived anew.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from shared import tables
from shared.bench_measures import Row
from shared.bench_runs import write_rows
from shared.figures import say
from shared.learning_measures import Case, vertex_errors

from clothtrack import __version__
from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.evaluation import Truth, chamfer_pc
from clothtrack.files import with_settings
from clothtrack.files.provenance import commit
from clothtrack.geometry import quiet_warp, visible_vertices
from clothtrack.planning import EpisodeStore, Estimate
from clothtrack.planning.perception import ONE_CANDIDATE, Look, TrackerPerception
from clothtrack.recordings import Recording, observe, read_recording, reversed_recording
from clothtrack.tracking import RunConfig, Tracker

NAME = "planning_perception"
NETWORK = "network"
ONE_ACTION, ALL_ACTIONS = "tracker, the last action", "tracker, every action"
NEARER = "network or tracker, the nearer to its cloud"
HINDSIGHT = "tracker, backwards from the end"


class Remembered:
    """The mesh that the episode has of one picture: what lost tracking falls back on."""

    def __init__(self, estimate: Estimate) -> None:
        """Remember it."""
        self._estimate = estimate

    def perceive(self, look: Look) -> Estimate:
        """What was believed of this picture then."""
        del look
        return self._estimate


def episodes(out: Path, kind: str) -> list[Path]:
    """Finished episodes that planned from a network's mesh, one per start.

    Raises:
        InvalidConfigError: there are none.
    """
    found: dict[str, Path] = {}
    for document in sorted(out.glob(f"flattening/*/episodes/{kind}_*/episode.json")):
        episode = json.loads(document.read_text(encoding="utf-8"))
        config, label = episode["asked"]["config"], episode["asked"]["label"]
        planned = config["policy"] == "planned" and label["perception"] == "network"
        if planned and episode["status"] != "running" and len(episode["steps"]) > 1:
            found.setdefault(document.parent.name, document.parent)
    if not found:
        raise InvalidConfigError(
            f"{out}: no finished episode of a {kind} planned from a network's mesh is there; "
            "flatten some with flattening.py"
        )
    return [found[name] for name in sorted(found)]


def believed(folder: Path, kind: str, config: RunConfig, device: str) -> Iterator[Row]:
    """One row per picture before, between and after the actions, and way to believe.

    Args:
        folder: of the episode.
        kind: the garment.
        config: how is tracked.
        device: where to track.
    """
    asked = json.loads((folder / "episode.json").read_text(encoding="utf-8"))["asked"]
    store = EpisodeStore(folder, asked)
    runs, name = folder.parents[1], folder.name
    recording = read_recording(runs / "recordings" / name)
    truth = Truth.load(runs / "truth" / f"{name}.npz")
    found = [store.estimate(step) for step in range(len(store.steps))]
    networks = [estimate for estimate in found if estimate is not None]
    behind, behind_cpu_s = hindsight(recording, networks[-1], truth.frames, config, device)
    carried = networks[0]
    for number, network in enumerate(networks):
        beliefs: dict[str, tuple[Estimate, float | None]] = {NETWORK: (network, None)}
        step = read_recording(store.recording_path(number))
        for variant, before in ((ONE_ACTION, networks[max(number - 1, 0)]), (ALL_ACTIONS, carried)):
            cpu = time.process_time()
            found = followed(step, before, network, config, device) if number else before
            beliefs[variant] = found, time.process_time() - cpu
        carried = beliefs[ALL_ACTIONS][0]
        beliefs[HINDSIGHT] = behind[number], behind_cpu_s / (len(networks) - 1)
        case = Case(recording, truth, int(truth.frames[number]), kind)
        rows = {
            variant: {**measured(estimate, case), "cpu_s": cpu_s}
            for variant, (estimate, cpu_s) in beliefs.items()
        }
        nearer = min((rows[NETWORK], rows[ALL_ACTIONS]), key=lambda row: row["chamfer_pc_m2"])
        rows[NEARER] = {**nearer, "cpu_s": rows[ALL_ACTIONS]["cpu_s"]}
        for variant, row in rows.items():
            yield {
                "experiment": NAME, "variant": variant, "recording": name, "kind": kind,
                "split": "", "action": number, "actions": len(networks) - 1, "stage": "after",
                **row, "provenance": {"clothtrack": __version__, "commit": commit()},
            }  # fmt: skip


def followed(
    step: Recording, before: Estimate, network: Estimate, config: RunConfig, device: str
) -> Estimate:
    """A belief carried through one action; the network's of its end where that fails."""
    perception = TrackerPerception(Remembered(network), tracker=config, device=device)
    return perception.perceive(Look(step, acted=True, before=before))


def hindsight(
    recording: Recording,
    last: Estimate,
    frames: np.ndarray,
    config: RunConfig,
    device: str,
) -> tuple[list[Estimate], float]:
    """The last belief tracked backwards: one per frame that is asked for, and CPU time [s]."""
    with tempfile.TemporaryDirectory(prefix=f"{NAME}-") as folder:
        backwards = reversed_recording(recording, Path(folder) / recording.name)
        cpu = time.process_time()
        tracked = Tracker(
            backwards, last.flat, config, partial(observe, backwards),
            start=last.positions, device=device,
        ).track()  # fmt: skip
    positions = tracked.positions[::-1][frames].astype(np.float64)
    beliefs = [Estimate(last.flat, each, "tracker") for each in positions]
    return beliefs, time.process_time() - cpu


def measured(estimate: Estimate, case: Case) -> Row:
    """A belief against cloud and truth."""
    mesh = replace(estimate.flat, vertices=estimate.positions)
    drawn, best = vertex_errors(mesh, case)
    cloud = observe(case.recording, case.recording.frames[case.frame]).points
    seen = visible_vertices(estimate.positions, mesh.faces, case.recording.cameras)
    return {
        "chamfer_pc_m2": chamfer_pc(estimate.positions, seen, cloud),
        "error_all_mm": drawn["all"].mean,
        "error_symmetric_mm": best["all"].mean,
        "error_symmetric_visible_mm": best["visible"].mean,
        "error_symmetric_hidden_mm": best["hidden"].mean,
        "anew": float(estimate.source == "network"),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the episodes")
    parser.add_argument("--kind", default="tshirt", choices=("towel", "tshirt"))
    parser.add_argument("--limit", type=int, help="episodes, at most")
    parser.add_argument(
        "--set", dest="settings", action="append", default=[], metavar="NAME=VALUE",
        help="of the tracker, such as objective.length_weight=100",
    )  # fmt: skip
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    options = parser.parse_args(arguments)
    quiet_warp()
    try:
        config = with_settings(ONE_CANDIDATE, options.settings)
        chosen = episodes(options.out, options.kind)[: options.limit]
        rows: list[Row] = []
        for number, folder in enumerate(chosen, start=1):
            rows += believed(folder, options.kind, config, options.device)
            write_rows(rows, options.out / f"{NAME}.jsonl")
            sys.stderr.write(f"{folder.name}: {number} of {len(chosen)}\n")
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    say(f"{__doc__.splitlines()[0]}\n\n{tables.markdown(NAME, rows)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
