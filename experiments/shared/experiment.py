"""The command line that every experiment over the benchmark shares.

    --bench FOLDER    recordings/, truth/ and, where there are splits, bench.json
    --out FOLDER      rows, OUT/NAME.jsonl, and all runs, OUT/runs (default: BENCH/experiments)
    --split NAME      dev, test or hard; a folder without bench.json is one split
    --limit N         so many trajectories, garments taking turns
    --vertices N      first mesh resampled to about N vertices on the template's own surface
    --smoke           one small towel, one action, a short calibration: does everything run?

Runs are stored by the hash of their settings, so experiments share them, and a second call resumes.
The printed tables are those that `tables.py` rebuilds from the rows.
"""

import argparse
import logging
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from clothtrack.errors import ClothTrackError
from clothtrack.geometry.devices import quiet_warp
from clothtrack.tracking.configuration import MODES, RunConfig
from clothtrack_lab.world.episodes import SMALL_WORLD, EpisodeConfig
from clothtrack_lab.world.filming import simulate
from shared import tables
from shared.ablations import settings_of
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
from shared.figures import say

SMOKE_AXES = {"table_friction": (0.3, 1.0)}
SMOKE_VERTICES = 80
SMOKE_SUBSTEP_S = 3.3e-3
FILMED_SEED = 5000
"""Of the first trajectory that an experiment films itself; the benchmark's seeds lie below."""

Run = tuple[Trajectory, Variant]


@dataclass(frozen=True)
class Setup:
    """The inputs of an experiment's plan.

    Attributes:
        split: the chosen split, None for all.
        vertices: resample first meshes to so many vertices; None leaves them.
        ray: address of the Ray cluster to track on; worker processes by default.
        options: the command line, with the experiment's own options.
    """

    bench: Path
    out: Path
    split: str | None = None
    limit: int | None = None
    vertices: int | None = None
    workers: int = 1
    ray: str = ""
    device: str = "cpu"
    smoke: bool = False
    options: argparse.Namespace = field(default_factory=argparse.Namespace)

    def trajectories(self, split: str | None = None) -> list[Trajectory]:
        """Return the trajectories of the chosen split, or of another one."""
        return trajectories(self.bench, split or self.split, self.limit)

    def variant(
        self, name: str, config: RunConfig | str = "default", method: str = "", **changes: object
    ) -> Variant:
        """Return a variant, which is small in a smoke run."""
        if isinstance(config, str):
            method = method or ("" if config in MODES else config)
            config = settings_of(config)
        if self.smoke:
            config = _short(config)
        return replace(Variant(name, config, method, vertex_count=self.vertices), **changes)

    def filmed(self, label: str, config: EpisodeConfig | None = None) -> list[Trajectory]:
        """Return trajectories recorded for this experiment, half of them towels; make missing ones.

        The seeds are the same for every `label`: same cloth, same actions, another `config`.
        """
        folder = self.out / "filmed" / label
        count = 1 if self.smoke else (self.limit or 8)
        for kind, number in (("towel", (count + 1) // 2), ("tshirt", count // 2)):
            if number:
                simulate(
                    folder, kind, number, seed=FILMED_SEED, config=config, processes=self.workers
                )
        return trajectories(folder, None, count)

    @property
    def world(self) -> EpisodeConfig:
        """Configuration of an experiment's own recordings, before it changes a setting."""
        return SMALL_WORLD if self.smoke else EpisodeConfig()

    def rows(self, experiment: str, runs: Sequence[Run]) -> list[Row]:
        """Make the missing runs; return every row with its labels."""
        tasks = [Task(*run, self.out / "runs", self.device) for run in runs]
        parts = run_all(tasks, workers=self.workers, ray=self.ray, progress=progress)
        return [
            {
                "experiment": experiment,
                "variant": task.variant.name,
                "recording": task.trajectory.name,
                "kind": task.trajectory.kind,
                "split": task.trajectory.split,
                "run": str(task.file.relative_to(self.out)),
                **row,
            }
            for task, part in zip(tasks, parts, strict=True)
            for row in part
        ]


Plan = Callable[[Setup], list[Run]]
AddOptions = Callable[[argparse.ArgumentParser], None]


def run_experiment(
    name: str,
    description: str,
    plan: Plan,
    arguments: Sequence[str] | None = None,
    add_options: AddOptions | None = None,
) -> int:
    """Plan, track missing runs, write the rows and print the tables; return the exit code."""

    def make(setup: Setup) -> list[Row]:
        runs = plan(setup)
        return setup.rows(name, _only(runs, setup.options.only) if setup.options.only else runs)

    return write_table(name, description, make, arguments, add_options)


def write_table(
    name: str,
    description: str,
    make: Callable[[Setup], list[Row]],
    arguments: Sequence[str] | None = None,
    add_options: AddOptions | None = None,
) -> int:
    """Make the rows, write them and print the tables; return the exit code."""
    options = parse(description, arguments, add_options)
    quiet_warp()
    logging.basicConfig(level=logging.INFO if options.verbose else logging.ERROR)
    with tempfile.TemporaryDirectory(prefix=f"{name}-") as temporary:
        bench = options.bench or Path(temporary)
        setup = Setup(
            bench=bench, out=options.out or bench / "experiments", split=options.split,
            limit=1 if options.smoke else options.limit, workers=options.workers,
            vertices=options.vertices or (SMOKE_VERTICES if options.smoke else None),
            ray=options.ray, device=options.device, smoke=options.smoke,
            options=options,
        )  # fmt: skip
        if options.smoke:
            simulate(bench, "towel", 1, config=SMALL_WORLD)
        try:
            rows = make(setup)
        except ClothTrackError as error:
            sys.stderr.write(f"{error}\n")
            return 1
        file = setup.out / f"{name}.jsonl"
        write_rows(rows, file)
        if options.smoke:
            say("Smoke run: one small towel, one action, a short calibration; it proves nothing.\n")
        say(f"{description.splitlines()[0]}\n\n{tables.markdown(name, read_rows(file))}")
    return 1 if not rows or all("error" in row for row in rows) else 0


def parse(
    description: str, arguments: Sequence[str] | None, add_options: AddOptions | None = None
) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--bench", type=Path, help="folder of the benchmark")
    parser.add_argument("--out", type=Path, help="folder of the rows (BENCH/experiments)")
    parser.add_argument("--split", help="dev, test or hard")
    parser.add_argument("--limit", type=int, help="so many trajectories")
    parser.add_argument("--vertices", type=int, help="resample first meshes to about so many")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="variants, or beginnings of them")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--ray", default="", metavar="ADDRESS", help="local, or a cluster")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--smoke", action="store_true", help="one small towel, under a minute")
    parser.add_argument("--verbose", action="store_true", help="log what happens")
    if add_options is not None:
        add_options(parser)
    options = parser.parse_args(arguments)
    if options.bench is None and not options.smoke:
        parser.error("give --bench FOLDER (clothtrack simulate FOLDER makes one), or --smoke")
    return options


def _only(runs: Sequence[Run], names: Sequence[str]) -> list[Run]:
    """Return runs of the variants of these names; what names none is the beginning of some."""
    all_names = {variant.name for _, variant in runs}
    wanted = {
        one
        for one in all_names
        for name in names
        if one == name or (name not in all_names and one.startswith(name))
    }
    return [(trajectory, variant) for trajectory, variant in runs if variant.name in wanted]


def _short(config: RunConfig) -> RunConfig:
    return replace(
        config,
        cloth=replace(config.cloth, substep_s=SMOKE_SUBSTEP_S),
        search=replace(config.search, axes=SMOKE_AXES),
        objective=replace(config.objective, iterations=5),
    )


def progress(text: str) -> None:
    """Tell on standard error how far it is."""
    sys.stderr.write(text)
    sys.stderr.flush()
