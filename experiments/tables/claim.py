"""Test the claim: the benefit to a network of tracked labels of a garment outside its training.

    python experiments claim --out OUT --garments tshirt sweater towel --networks tokens published \
        --seeds 0 1 2 --labels before truth default paper open_loop usual --label-error 2 5 10 20 40

The garment is recorded in a simulated world as difficult as a lab (`shared/unkind_world.py`). A
network learns from each kind of label of its recordings in turn, and is scored against the truth on
held-out recordings. `usual` are as many pictures of the same garment without tracking: the same
actions in the tracker's own simulator, uncalibrated, drawn as in pretraining. `--label-error` makes
the true labels wrong by so many millimeters.

Finished cells are stored in OUT/claim.jsonl, and the table has all of them. A second call resumes;
`--only-print` just prints.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import _path  # noqa: F401
import numpy as np
from shared.bench_measures import Row
from shared.bench_runs import Task, Trajectory, read_rows, run_all, write_rows
from shared.claim_table import GROUP, markdown
from shared.experiment import Setup
from shared.figures import say
from shared.held_out import require_apart
from shared.learning_experiment import SMOKE_SETTINGS, tiny_network
from shared.learning_labels import simulated_labels, tracked_labels, true_labels, wrong_labels
from shared.learning_runs import Reconstructor, Tuner, reconstruction_rows
from shared.unkind_world import GARMENTS, HELD_OUT_SEED, LEARNED_SEED, film

import clothtrack
import clothtrack_lab
from clothtrack.errors import ClothTrackError
from clothtrack.geometry import quiet_warp
from clothtrack.reconstruction.data.pseudo_labels import LabeledRecording
from clothtrack.tracking import mode
from clothtrack.tracking.search import SearchConfig

BEFORE, TRUTH, USUAL = "before", "truth", "usual"
TRACKED = ("default", "paper", "open_loop")
LABELS = (BEFORE, TRUTH, *TRACKED, USUAL)
NETWORKS = ("tokens", "published")

ROWS = "claim.jsonl"


@dataclass(frozen=True)
class Cell:
    """One line of a table: one training, judged on all that is held out.

    Attributes:
        garment: a key of `GARMENTS`.
        network: "tokens" or "published".
        labels: what is learned from; "error N mm" is the truth made wrong.
        seed: of the training.
    """

    garment: str
    network: str
    labels: str
    seed: int


@dataclass(frozen=True)
class Claim:
    """What the command line asks for.

    Attributes:
        out: folder of everything.
        recordings: to learn from.
        held_out: to measure on.
        smoke: napkins and a network that has learned nothing.
    """

    out: Path
    recordings: int
    held_out: int
    smoke: bool = False

    def learned(self, garment: str) -> list[Trajectory]:
        """Return the recordings of a garment to learn from."""
        return self._filmed(garment, "learned", self.recordings, LEARNED_SEED)

    def measured(self, garment: str) -> list[Trajectory]:
        """Return the recordings of a garment to measure on."""
        return self._filmed(garment, "held_out", self.held_out, HELD_OUT_SEED)

    def _filmed(self, garment: str, name: str, count: int, seed: int) -> list[Trajectory]:
        folder = self.out / "filmed" / garment / name
        return film(folder, GARMENTS[garment], count, seed, smoke=self.smoke)

    def rows(self, cell: Cell) -> list[Row]:
        """Return one row per held-out picture."""
        weights, error_mm = self._start(cell), None
        if cell.labels != BEFORE:
            learned = self.learned(cell.garment)
            measured = (one.recording for one in self.measured(cell.garment))
            require_apart((one.recording for one in learned), measured)
            labels, error_mm = self._labels(cell.labels, learned)
            tuner = Tuner(
                self.out / "networks", "finetune_short",
                SMOKE_SETTINGS if self.smoke else (), seed=cell.seed,
            )  # fmt: skip
            weights = tuner.tuned(weights, labels)
        how = Reconstructor(cell.labels, weights)
        named = {
            "experiment": "claim", "garment": cell.garment, "network": cell.network,
            "variant": cell.labels, "seed": cell.seed, "label_error_mm": error_mm,
            "recordings": self.recordings, "held_out": self.held_out,
        }  # fmt: skip
        return [
            {**named, "recording": one.name, "kind": one.kind, **row}
            for one in self.measured(cell.garment)
            for row in reconstruction_rows(one, how, self.out / "reconstructions")
        ]

    def _start(self, cell: Cell) -> Path:
        kind = GARMENTS[cell.garment].kind
        if self.smoke:
            return tiny_network(self.out / "tiny.safetensors", kind)
        if cell.network == "tokens":
            return Path(clothtrack.__file__).parent / "reconstruction/weights/tokens.safetensors"
        lab = Path(clothtrack_lab.__file__).parent
        return lab / f"published_networks/weights/{kind}.safetensors"

    def _labels(
        self, name: str, learned: Sequence[Trajectory]
    ) -> tuple[list[LabeledRecording], float]:
        """Return the labels of a name, and their own mean error [mm]."""
        if name in TRACKED:
            tasks = self._tracked(name, learned)
            rows = [row for task in tasks for row in read_rows(task.file)]
            errors = [row["error_all_mm"] for row in rows if row["stage"] == "after"]
            return [tracked_labels(task) for task in tasks], float(np.mean(errors))
        if name == USUAL:
            return [simulated_labels(task) for task in self._tracked(USUAL, learned)], 0.0
        # Any run has the frames and the vertices that the truth is asked for.
        tasks = self._tracked(USUAL, learned)
        if name == TRUTH:
            return [true_labels(task) for task in tasks], 0.0
        error_mm = float(name.split()[1])
        return [wrong_labels(task, 1e-3 * error_mm) for task in tasks], error_mm

    def _tracked(self, name: str, learned: Sequence[Trajectory]) -> list[Task]:
        """Return finished runs; a recording that cannot be tracked is left out, and said so."""
        setup = Setup(self.out, self.out, smoke=self.smoke)
        config = mode(name) if name in TRACKED else mode("open_loop")
        if name == USUAL:
            config = replace(config, search=SearchConfig(method="none"))
        variant = setup.variant(name, config)
        tasks = [Task(one, variant, self.out / "runs") for one in learned]
        for task, rows in zip(tasks, run_all(tasks, progress=_progress), strict=True):
            if "error" in rows[0]:
                _progress(f"{task.trajectory.name} has no label: {rows[0]['error']}\n")
        return [task for task in tasks if task.file.exists()]


def cells(options: argparse.Namespace) -> Iterator[Cell]:
    """Yield what is asked for, seed by seed."""
    names = [*options.labels, *(f"error {each:g} mm" for each in options.label_error)]
    for seed in options.seeds:
        for name in names:
            for garment in options.garments:
                for network in options.networks:
                    # What has not learned has no seed.
                    if name != BEFORE or seed == options.seeds[0]:
                        yield Cell(garment, network, name, 0 if name == BEFORE else seed)


def keep(rows: Sequence[Row], file: Path) -> None:
    """Put the rows of a cell in the place of older ones."""
    keys = (*GROUP, "variant", "seed")
    new = {tuple(row[key] for key in keys) for row in rows}
    old = read_rows(file) if file.exists() else []
    write_rows([*(row for row in old if tuple(row[k] for k in keys) not in new), *rows], file)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make what is missing, print the table of all that is finished; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="folder of recordings, networks and rows")
    parser.add_argument("--garments", nargs="+", choices=GARMENTS, default=["tshirt"])
    parser.add_argument("--networks", nargs="+", choices=NETWORKS, default=["tokens"])
    parser.add_argument("--labels", nargs="*", choices=LABELS, default=[], help="to learn from")
    parser.add_argument("--label-error", nargs="*", type=float, default=[], help="millimeters")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0], help="of the training")
    parser.add_argument("--recordings", type=int, default=10, help="to learn from")
    parser.add_argument("--held-out", type=int, default=5, help="recordings to measure on")
    parser.add_argument("--only-print", action="store_true", help="compute nothing")
    parser.add_argument("--smoke", action="store_true", help="napkins, under a minute")
    options = parser.parse_args(arguments)
    if options.out is None and not options.smoke:
        parser.error("give --out FOLDER, or --smoke")
    quiet_warp()
    with tempfile.TemporaryDirectory(prefix="claim-") as temporary:
        claim = Claim(
            options.out or Path(temporary), options.recordings, options.held_out, options.smoke
        )
        if options.smoke:
            claim = replace(claim, recordings=2, held_out=1)
            options.garments, options.networks = ["towel"], ["published"]
            options.labels, options.label_error = list(LABELS), [5.0]
        file = claim.out / ROWS
        try:
            for cell in () if options.only_print else cells(options):
                rows = claim.rows(cell)
                keep(rows, file)
                _progress(f"{cell}: {rows[0].get('error') or 'measured'}\n")
        except ClothTrackError as error:
            sys.stderr.write(f"{error}\n")
            return 1
        rows = read_rows(file) if file.exists() else []
    if options.smoke:
        say("Smoke run: napkins and a network that has learned nothing; no result.\n\n")
    say(markdown(rows))
    return 0 if rows and not all("error" in row for row in rows) else 1


def _progress(text: str) -> None:
    sys.stderr.write(text)
    sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
