"""Compare dynamics for planning on executed actions: the simulator and the learned ones.

Every pick-and-place that the episodes of `flattening.py` did in the simulated world is predicted
again from the true cloth before it: where the cloth ends, and what coverage is gained. At the start
of each episode all decide among the same candidates, for the time that it takes. Claims judged: the
learned dynamics are as good as the simulator; a coarse cloth must buckle between its vertices. A
control, because predictions begin with the truth.

    python experiments planning_dynamics --out OUT --kind tshirt

OUT is that of `flattening.py`.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import spearmanr
from shared import tables
from shared.bench_measures import Row
from shared.bench_runs import write_rows
from shared.figures import say

from clothtrack import __version__
from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.files.provenance import commit
from clothtrack.geometry.coverage import projected_area
from clothtrack.geometry.devices import quiet_warp
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.planning.action_space import PickPlace, SeenCloth
from clothtrack.planning.coarse_cloth import Coarsener
from clothtrack.planning.flatten_config import FlattenConfig, dynamics_of
from clothtrack.planning.planner import Hypothesis, Planner, coverage
from clothtrack.planning.planning_dynamics import (
    PLANNING_SOLVER,
    PlannedCloth,
    PlanningDynamics,
    SimulatorDynamics,
)

NAME = "planning_dynamics"
LEARNED = "learned mesh dynamics"
SIMULATOR = "simulator"
STRUTS = "simulator, edges are struts"
"""With edges that resist a push as they do a pull (`SolverConfig.buckling`)."""


@dataclass(frozen=True, eq=False)
class Done:
    """One pick-and-place that was done.

    Attributes:
        flat: the true garment, with canonical coordinates.
        number: of the action in its episode, from 1.
        before: true vertices before it [m].
        after: true vertices after it [m].
    """

    flat: ClothMesh
    policy: str
    number: int
    action: PickPlace
    before: np.ndarray
    after: np.ndarray


def episodes(out: Path, kind: str) -> Mapping[int, list[Done]]:
    """Return all actions that are on disk, by the seed of their episode."""
    found: dict[int, list[Done]] = {}
    for document in sorted(out.glob(f"flattening/*/episodes/{kind}_*/episode.json")):
        episode = json.loads(document.read_text(encoding="utf-8"))
        if episode["status"] == "running":
            continue
        name = document.parent.name
        worlds = document.parents[2] / "worlds" / name
        flat = _garment(document.parents[2] / "truth" / f"{name}.npz")
        asked = episode["asked"]
        policy = asked["config"]["policy"]
        for row in episode["steps"][1:]:
            number = int(row["step"])
            text = row["action"]
            done = Done(
                flat, policy, number,
                PickPlace(np.array(text["pick"]), np.array(text["place"]), float(text["lift_m"])),
                _positions(worlds, number - 1), _positions(worlds, number),
            )  # fmt: skip
            found.setdefault(int(asked["seed"]), []).append(done)
    if not found:
        raise InvalidConfigError(
            f"{out}: no episodes of a {kind} are there; flatten some with flattening.py"
        )
    return dict(sorted(found.items()))


def _garment(truth: Path) -> ClothMesh:
    with np.load(truth, allow_pickle=False) as file:
        return ClothMesh(file["canonical"], file["faces"], file["canonical"])


def _positions(worlds: Path, step: int) -> np.ndarray:
    with np.load(worlds / f"{step:02d}.npz", allow_pickle=False) as file:
        return file["positions"].astype(np.float64)


def contenders(dynamics_weights: Path | None, device: str) -> Mapping[str, PlanningDynamics]:
    """Return what is compared."""
    learned = FlattenConfig(dynamics="mesh", dynamics_weights=str(dynamics_weights or ""))
    return {
        SIMULATOR: SimulatorDynamics(device=device),
        STRUTS: SimulatorDynamics(solver=replace(PLANNING_SOLVER, buckling=1.0), device=device),
        LEARNED: dynamics_of(learned, device=device),
    }


def predicted(
    kind: str, seed: int, done: Sequence[Done], asked: Mapping[str, PlanningDynamics]
) -> Iterator[Row]:
    """Yield one row per action and dynamics, and one per dynamics for the first decision."""
    flat = done[0].flat
    coarseners = {name: Coarsener(flat, kind, dynamics.coarse) for name, dynamics in asked.items()}
    named = {"experiment": NAME, "recording": f"{kind}_{seed}", "kind": kind, "split": "",
             "actions": max(one.number for one in done), "stage": "after"}  # fmt: skip
    stamp = {"clothtrack": __version__, "commit": commit(), "seed": seed}
    for one in done:
        gain = projected_area(one.after, flat.faces) - projected_area(one.before, flat.faces)
        for name, dynamics in asked.items():
            coarsen = coarseners[name]
            cloth = PlannedCloth(
                coarsen.flat, coarsen(one.before), fine=one.before, stands_for=coarsen.stands_for
            )
            true_end = coarsen(one.after)
            ends = dynamics.predict(cloth, [None, one.action])
            areas = coverage(ends, coarsen.flat.faces)
            yield {
                **named, "variant": name, "action": one.number, "policy": one.policy,
                "end_error_mm": _mm(ends[1], true_end), "still_mm": _mm(cloth.positions, true_end),
                "rest_error_mm": _mm(ends[0], cloth.positions),
                "promised_m2": float(areas[1] - areas[0]), "gain_m2": gain, "provenance": stamp,
            }  # fmt: skip
    for name, row in _decisions(flat, done[0].before, kind, seed, asked).items():
        yield {**named, "variant": name, "action": 1, **row, "provenance": stamp}


def _mm(one: np.ndarray, other: np.ndarray) -> float:
    return 1e3 * float(np.linalg.norm(one - other, axis=1).mean())


def _decisions(
    flat: ClothMesh,
    start: np.ndarray,
    kind: str,
    seed: int,
    asked: Mapping[str, PlanningDynamics],
) -> Mapping[str, Row]:
    """Return what a decision among the same candidates takes, and how alike they are rated."""
    # What lies on top may be picked; a camera would see about the same.
    columns = cKDTree(start[:, :2]).query_ball_point(start[:, :2], 0.01)
    tops = np.array([start[column, 2].max() for column in columns])
    seen = SeenCloth(start[start[:, 2] > tops - 0.003], None)
    rows: dict[str, Row] = {}
    gains: dict[str, np.ndarray] = {}
    for name, dynamics in asked.items():
        decision = Planner(dynamics).decide(
            Hypothesis(flat, start, kind), seen, np.random.default_rng(seed)
        )
        gains[name] = decision.gains_m2
        rows[name] = {"decision_cpu_s": decision.cpu_s, "candidates": len(decision.candidates)}
    for name, row in rows.items():
        row["agreement"] = float(spearmanr(gains[name], gains[SIMULATOR]).statistic)
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the episodes")
    parser.add_argument("--kind", default="tshirt", choices=("towel", "tshirt"))
    parser.add_argument("--dynamics", type=Path, help="weights; those that come along by default")
    parser.add_argument("--limit", type=int, help="starts, at most")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    options = parser.parse_args(arguments)
    quiet_warp()
    try:
        asked = contenders(options.dynamics, options.device)
        chosen = list(episodes(options.out, options.kind).items())[: options.limit]
        rows: list[Row] = []
        for number, (seed, done) in enumerate(chosen, start=1):
            rows += predicted(options.kind, seed, done, asked)
            write_rows(rows, options.out / f"{NAME}.jsonl")
            sys.stderr.write(f"{options.kind}_{seed}: {number} of {len(chosen)}\n")
    except ClothTrackError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    say(f"{__doc__.splitlines()[0]}\n\n{tables.markdown(NAME, rows)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
