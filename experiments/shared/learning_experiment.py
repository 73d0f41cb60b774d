"""The command line that the experiments with the network share.

    --weights FILE...   one per garment: model.safetensors of pretrain, finetune or the package; the
                        token network's serves every garment that no other one is given for
    --bench FOLDER      recordings/, truth/ and bench.json
    --old FOLDER...     simulated states, one folder per garment: the control's old cloth
    --train NAME        split whose tracked trajectories are learned from (dev)
    --split NAME        split that is held out and measured (test); a folder without bench.json has
                        two: the last tenth of each garment's trajectories is held out, or the last
                        --held-out N
    --set NAME=VALUE    of the training, such as canonicalisation.epochs=200
    --counts N...       trajectories to learn from (label_count only)
    --only NAME...      labels to learn from, as the table calls them (table2 only)
    --smoke             small towels, a tiny network made on the spot: does everything run?

Tracked runs, fine-tuned networks and rows are kept by the hash of their settings, and shared with
the experiments over the benchmark. What is printed is what `tables.py` rebuilds from the rows.
"""

import argparse
import logging
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from clothtrack.errors import ClothTrackError, InvalidConfigError
from clothtrack.geometry import quiet_warp
from clothtrack.reconstruction import open_states
from clothtrack.reconstruction.data.garment_draws import GarmentRanges
from clothtrack.reconstruction.data.recipes import CrumplingConfig
from clothtrack.reconstruction.data.state_store import StateSet
from clothtrack.reconstruction.data.states import StatesConfig, generate_states
from clothtrack.reconstruction.tokens.token_learning import KIND as ANY_GARMENT
from clothtrack.reconstruction.training.checkpoint import save_weights
from clothtrack_lab.published_networks.model import MeshReconstructor
from clothtrack_lab.published_networks.network_config import TINY_NETWORK
from clothtrack_lab.world import SMALL_WORLD, simulate
from clothtrack_lab.world.bench import vary
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
from shared.held_out import learned_from, measured_on, parted, require_apart
from shared.learning_runs import Reconstructor, Tuner, kind_of, reconstruction_rows

SMOKE_SETTINGS = (
    "canonicalisation.epochs=1", "completion.epochs=1", "canonicalisation.evaluate_epochs=1",
    "completion.evaluate_epochs=1", "examples.winding.pool=1024", "examples.surface_queries=64",
    "examples.volume_queries=64",
)  # fmt: skip
SMOKE_STATES = StatesConfig(
    vertex_count=120,
    episodes=2,
    crumpling=CrumplingConfig(states=2, rest_limit_s=0.3),
    garments=GarmentRanges(towel_side_m=(0.22, 0.34)),
)
SMOKE_TOWELS = 3
"""Filmed in a smoke run: all but the last to learn from, the last held out."""

COUNTS = (5, 10, 20, 45)
"""Trajectories of each garment that fine-tuning is tried with; 45 in the paper."""

SMOKE_COUNTS = (2, 3)

MORE_SEEDS = 7000
"""Of trajectories filmed to learn from beyond the benchmark's, whose seeds lie below."""


@dataclass(frozen=True)
class LearningSetup:
    """What an experiment with the network plans with.

    Attributes:
        tracking: how trajectories are tracked, and where rows and runs are.
        weights: of the network to begin with, by garment.
        tuner: how it is fine-tuned.
        old: states of the old cloth, by garment.
        train_split: whose tracked trajectories are learned from.
        limit: most trajectories of each garment, to learn from and to measure.
        counts: how many trajectories are learned from, where that is what is asked.
        only: names of the label sets that are learned from; empty: all.
        held_out_count: trajectories of each garment that a folder without splits holds out; None:
            a tenth.
    """

    tracking: Setup
    weights: dict[str, Path]
    tuner: Tuner
    old: dict[str, Path] = field(default_factory=dict)
    train_split: str = "dev"
    limit: int | None = None
    counts: tuple[int, ...] = COUNTS
    only: tuple[str, ...] = ()
    held_out_count: int | None = None

    def training(self, kind: str) -> list[Trajectory]:
        """The trajectories to learn from.

        Raises:
            InvalidConfigError: there are none, or one of them is measured on too.
        """
        found = self._of(kind, held_out=False)
        if not found:
            raise InvalidConfigError(
                f"{self.tracking.bench}: it has no trajectory of a {kind} to learn from; film "
                f"more: clothtrack simulate {self.tracking.bench} --garment {kind}"
            )
        self._require_apart(kind, found)
        return found

    def held_out(self, kind: str) -> list[Trajectory]:
        """The trajectories to measure on.

        Raises:
            InvalidConfigError: they would be learned from too.
        """
        if not self.tracking.smoke and self.train_split == self.tracking.split:
            raise InvalidConfigError(
                f"--train and --split are both {self.train_split!r}; what is measured on must not "
                "be learned from"
            )
        return self._of(kind, held_out=True)

    def _of(self, kind: str, *, held_out: bool) -> list[Trajectory]:
        bench, split = self.tracking.bench, self.tracking.split
        if self.tracking.smoke:
            # One folder without splits; what else has been filmed there comes after these.
            own = [one for one in trajectories(bench) if one.kind == kind]
            first = sorted(own, key=lambda one: one.name)[:SMOKE_TOWELS]
            return parted(first)[held_out]
        count = self.held_out_count
        of = (
            measured_on(bench, split, count)
            if held_out
            else learned_from(bench, self.train_split, count)
        )
        return [one for one in of if one.kind == kind][: self.limit]

    def _require_apart(self, kind: str, learned: Sequence[Trajectory]) -> None:
        measured = (one.recording for one in self.held_out(kind))
        require_apart((one.recording for one in learned), measured)

    def more(self, kind: str, count: int) -> list[Trajectory]:
        """So many trajectories to learn from: the split's, and as many more as that takes."""
        found = self.training(kind)[:count]
        folder = self.tracking.out / "filmed" / "more"
        for seed in range(MORE_SEEDS, MORE_SEEDS + count - len(found)):
            world = SMALL_WORLD if self.tracking.smoke else vary(kind, seed)
            simulate(folder, kind, 1, seed=seed, config=world)
        if count > len(found):
            filmed = [one for one in trajectories(folder) if one.kind == kind]
            found += sorted(filmed, key=lambda one: one.name)[: count - len(found)]
            self._require_apart(kind, found)
        return found

    def tracked(self, chosen: Sequence[Trajectory], variant: Variant) -> list[Task]:
        """Finished runs of these trajectories; tracked where they are not kept.

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

    def old_states(self, kind: str) -> StateSet | None:
        """The states that the network was pretrained on, or others of their like."""
        return open_states(self.old[kind]) if kind in self.old else None

    def rows(self, experiment: str, how: Reconstructor, chosen: Sequence[Trajectory]) -> list[Row]:
        """One row per action of each trajectory, with its labels."""
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
    """What the command line asks for; in a smoke run, made on the spot."""
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
    settings = (*(SMOKE_SETTINGS if options.smoke else ()), *options.settings)
    old = {open_states(path).kind: path for path in options.old}
    if options.smoke:
        simulate(bench, "towel", SMOKE_TOWELS, config=SMALL_WORLD)
        states = out / "old_states"
        if not states.exists():
            generate_states(states, "towel", 4, config=SMOKE_STATES)
        old = old or {"towel": states}
    weights = weights_of_garments(options.weights, bench)
    if options.smoke and not weights:
        weights = {"towel": tiny_network(out / "tiny.safetensors")}
    return LearningSetup(
        tracking=tracking,
        weights=weights,
        tuner=Tuner(
            out / "networks",
            options.training,
            settings,
            seed=options.seed,
            device=options.device,
            old=old,
        ),
        old=old,
        train_split=options.train,
        limit=options.limit,
        counts=SMOKE_COUNTS if options.smoke else tuple(options.counts),
        only=tuple(options.only),
        held_out_count=options.held_out,
    )


def weights_of_garments(paths: Sequence[Path], bench: Path) -> dict[str, Path]:
    """The weights for every garment that they are for.

    Args:
        paths: files of weights; those of the token network serve each garment of the benchmark that
            no other file is for.
        bench: folder of the benchmark.

    Raises:
        InvalidConfigError: the benchmark is empty.
        InvalidResultError: weights are missing or damaged.
    """
    found = {kind: path for path in paths if (kind := kind_of(path)) != ANY_GARMENT}
    tokens = [path for path in paths if kind_of(path) == ANY_GARMENT]
    kinds = dict.fromkeys(one.kind for one in trajectories(bench)) if tokens else ()
    return found | {kind: tokens[-1] for kind in kinds if kind not in found}


def tiny_network(path: Path, kind: str = "towel") -> Path:
    """A network that has learned nothing, small enough for a smoke run."""
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
    parser.add_argument("--old", type=Path, nargs="+", default=[], help="folders of states")
    parser.add_argument("--train", default="dev", help="split to learn from")
    parser.add_argument("--split", default="test", help="split to measure on")
    parser.add_argument("--limit", type=int, help="so many trajectories of each garment")
    parser.add_argument("--held-out", type=int, help="so many of a folder without splits")
    parser.add_argument("--only", nargs="+", default=(), help="labels to learn from")
    parser.add_argument("--counts", type=int, nargs="+", default=COUNTS, help="to learn from")
    presets = ("finetune", "finetune_short", "paper")
    parser.add_argument("--training", choices=presets, default="finetune", help="how it is tuned")
    parser.add_argument("--set", dest="settings", action="append", default=[], help="a setting")
    parser.add_argument("--seed", type=int, default=0, help="of the training")
    parser.add_argument("--workers", type=int, default=1, help="processes that track")
    parser.add_argument("--ray", default="", metavar="ADDRESS", help=RAY_HELP)
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--smoke", action="store_true", help="small towels, under a minute")
    parser.add_argument("--verbose", action="store_true", help="log what happens")


def refined(how: Reconstructor, name: str) -> Reconstructor:
    """The same with fine-tuning at test time."""
    return replace(how, name=name, refined=True)


def _progress(text: str) -> None:
    sys.stderr.write(text)
    sys.stderr.flush()
