"""The command line that the experiments with the network share.

    --weights FILE...   one per garment: model.safetensors of pretrain, finetune or the package; the
                        token network's serves every garment that no other one is given for
    --bench FOLDER      recordings/, truth/ and bench.json
    --split NAME        split that is measured (test); in a folder without bench.json the last tenth
                        of each garment's trajectories is, or the last --held-out N
    --smoke             small towels, a tiny network made on the spot: does everything run?

Tracked runs and rows are stored by the hash of their settings, and shared with the experiments over
the benchmark. The printed tables are those that `tables.py` rebuilds from the rows.
"""

import argparse
import logging
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from clothtrack.errors import ClothTrackError
from clothtrack.geometry import quiet_warp
from clothtrack.reconstruction.tokens.token_learning import KIND as ANY_GARMENT
from clothtrack.reconstruction.training.checkpoint import save_weights
from clothtrack_lab.published_networks.model import MeshReconstructor
from clothtrack_lab.published_networks.network_config import TINY_NETWORK
from clothtrack_lab.world import SMALL_WORLD, simulate
from shared import tables
from shared.bench_measures import Row
from shared.bench_runs import (
    Task,
    Trajectory,
    Variant,
    read_rows,
    run_all,
    trajectories,
    write_rows,
)
from shared.experiment import RAY_HELP, Setup
from shared.figures import say
from shared.held_out import measured_on, parted
from shared.learning_runs import Reconstructor, kind_of, reconstruction_rows

SMOKE_SETTINGS = (
    "canonicalisation.epochs=1", "completion.epochs=1", "canonicalisation.evaluate_epochs=1",
    "completion.evaluate_epochs=1", "examples.winding.pool=1024", "examples.surface_queries=64",
    "examples.volume_queries=64",
)  # fmt: skip
SMOKE_TOWELS = 3
"""Filmed in a smoke run; the last is held out."""


@dataclass(frozen=True)
class LearningSetup:
    """What an experiment with the network plans with.

    Attributes:
        tracking: how trajectories are tracked, and where rows and runs are.
        held_out_count: trajectories of each garment that a folder without splits holds out; None:
            a tenth.
    """

    tracking: Setup
    weights: dict[str, Path]
    limit: int | None = None
    held_out_count: int | None = None

    def held_out(self, kind: str) -> list[Trajectory]:
        """Return the trajectories to measure on."""
        bench, split = self.tracking.bench, self.tracking.split
        if self.tracking.smoke:
            # One folder without splits; what else has been filmed there comes after these.
            own = [one for one in trajectories(bench) if one.kind == kind]
            return parted(sorted(own, key=lambda one: one.name)[:SMOKE_TOWELS])[1]
        found = measured_on(bench, split, self.held_out_count)
        return [one for one in found if one.kind == kind][: self.limit]

    def tracked(self, chosen: Sequence[Trajectory], variant: Variant) -> list[Task]:
        """Return finished runs of these trajectories; tracked where they are not kept.

        A trajectory that cannot be tracked is left out, and said so.
        """
        tasks = [
            Task(one, variant, self.tracking.out / "runs", self.tracking.device) for one in chosen
        ]
        parts = run_all(
            tasks, workers=self.tracking.workers, ray=self.tracking.ray, progress=_progress
        )
        for task, rows in zip(tasks, parts, strict=True):
            if "error" in rows[0]:
                _progress(f"{task.trajectory.name} has no label: {rows[0]['error']}\n")
        return [task for task in tasks if task.file.exists()]

    def rows(self, experiment: str, how: Reconstructor, chosen: Sequence[Trajectory]) -> list[Row]:
        """Return one row per action of each trajectory, with its labels."""
        default = self.tracking.variant("default", "default")
        runs = {task.trajectory.name: task for task in self.tracked(chosen, default)}
        store = self.tracking.out / "reconstructions"
        found = []
        for one in chosen:
            rows = reconstruction_rows(one, how, store, label=runs.get(one.name))
            named = {
                "experiment": experiment,
                "variant": how.name,
                "recording": one.name,
                "kind": one.kind,
                "split": one.split,
            }
            found += [{**named, **row} for row in rows]
            _progress(f"{how.name}, {one.name}: {rows[0].get('error') or 'measured'}\n")
        return found


Plan = Callable[[LearningSetup], list[Row]]


def run_learning(
    name: str, description: str, plan: Plan, arguments: Sequence[str] | None = None
) -> int:
    """Make what is missing, write the rows, print the tables; returns the exit code."""
    options = parse(description, arguments)
    quiet_warp()
    logging.basicConfig(level=logging.INFO if options.verbose else logging.ERROR)
    with tempfile.TemporaryDirectory(prefix=f"{name}-") as temporary:
        try:
            setup = prepared(options, Path(temporary))
            rows = plan(setup)
        except ClothTrackError as error:
            sys.stderr.write(f"{error}\n")
            return 1
        file = setup.tracking.out / f"{name}.jsonl"
        write_rows(rows, file)
        if options.smoke:
            say("Smoke run: small towels and a network that has learned nothing; no result.\n\n")
        say(f"{description.splitlines()[0]}\n\n{tables.markdown(name, read_rows(file))}")
    return 1 if not rows or all("error" in row for row in rows) else 0


def prepared(options: argparse.Namespace, temporary: Path) -> LearningSetup:
    """Return what the command line asks for; in a smoke run, made on the spot."""
    bench = options.bench or temporary
    out = options.out or bench / "experiments"
    tracking = Setup(
        bench=bench,
        out=out,
        split=options.split,
        workers=options.workers,
        ray=options.ray,
        device=options.device,
        smoke=options.smoke,
    )
    if options.smoke:
        simulate(bench, "towel", SMOKE_TOWELS, config=SMALL_WORLD)
    weights = weights_of_garments(options.weights, bench)
    if options.smoke and not weights:
        weights = {"towel": tiny_network(out / "tiny.safetensors")}
    return LearningSetup(tracking, weights, options.limit, options.held_out)


def weights_of_garments(paths: Sequence[Path], bench: Path) -> dict[str, Path]:
    """Return the weights for every garment that they are for."""
    found = {kind: path for path in paths if (kind := kind_of(path)) != ANY_GARMENT}
    tokens = [path for path in paths if kind_of(path) == ANY_GARMENT]
    kinds = dict.fromkeys(one.kind for one in trajectories(bench)) if tokens else ()
    return found | {kind: tokens[-1] for kind in kinds if kind not in found}


def tiny_network(path: Path, kind: str = "towel") -> Path:
    """Return a network that has learned nothing, small enough for a smoke run."""
    import torch

    if not path.exists():
        torch.manual_seed(0)
        save_weights(
            path, MeshReconstructor(TINY_NETWORK, kind).state_dict(), TINY_NETWORK, kind=kind
        )
    return path


def parse(description: str, arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    add_options(parser)
    options = parser.parse_args(arguments)
    if not options.smoke and (options.bench is None or not options.weights):
        parser.error("give --bench FOLDER and --weights FILE... (one per garment), or --smoke")
    return options


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options that every experiment with the network has."""
    parser.add_argument("--weights", type=Path, nargs="+", default=[], help="one per garment")
    parser.add_argument("--bench", type=Path, help="folder of the benchmark")
    parser.add_argument("--out", type=Path, help="folder of the rows (BENCH/experiments)")
    parser.add_argument("--split", default="test", help="split to measure on")
    parser.add_argument("--limit", type=int, help="so many trajectories of each garment")
    parser.add_argument("--held-out", type=int, help="so many of a folder without splits")
    parser.add_argument("--workers", type=int, default=1, help="processes that track")
    parser.add_argument("--ray", default="", metavar="ADDRESS", help=RAY_HELP)
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--smoke", action="store_true", help="small towels, under a minute")
    parser.add_argument("--verbose", action="store_true", help="log what happens")


def refined(how: Reconstructor, name: str) -> Reconstructor:
    """Return the same with fine-tuning at test time."""
    return replace(how, name=name, refined=True)


def _progress(text: str) -> None:
    sys.stderr.write(text)
    sys.stderr.flush()
