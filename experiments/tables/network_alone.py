"""Measure the network alone, next to Table 1: each action's last frame reconstructed by itself.

The paper's table has it at 3.0 (1e-4 m^2). Both ways to a mesh (the token network has one), each
with and without fine-tuning at test time. Nothing is tracked: there is no TTO2, so that both of its
sides show the same mesh.

    python experiments network_alone --bench OUT --weights TOWEL TSHIRT --split test
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import _path  # noqa: F401
from shared.bench_measures import Row
from shared.bench_runs import Task, run_all, trajectories
from shared.experiment import Setup, progress, write_table
from shared.held_out import measured_on
from shared.learning_runs import Reconstructor, kind_of, reconstruction_rows, tiny_network

from clothtrack.reconstruction.tokens.token_learning import KIND as ANY_GARMENT

METHODS = "template", "implicit"


def make(setup: Setup) -> list[Row]:
    """Return the rows of every way on every trajectory, one an action."""
    found = (
        setup.trajectories()
        if setup.smoke
        else measured_on(setup.bench, setup.split or "test", setup.options.held_out)
    )
    rows: list[Row] = []
    for kind, weights in weights_of_garments(setup).items():
        chosen = [one for one in found if one.kind == kind][: setup.limit]
        # Where a recording was tracked, the mesh is compared with the tracker's label too.
        tasks = [
            Task(one, setup.variant("default"), setup.out / "runs", setup.device) for one in chosen
        ]
        run_all(tasks, workers=setup.workers, ray=setup.ray, progress=progress)
        for method in METHODS if kind_of(weights) == kind else METHODS[:1]:
            plain = Reconstructor(f"network, {method}", weights, method)
            tuned = replace(plain, name=f"{plain.name}, fine-tuned at test time", refined=True)
            for how in (plain, tuned):
                for one, task in zip(chosen, tasks, strict=True):
                    label = task if task.file.exists() else None
                    rows += [
                        {
                            "experiment": "network_alone", "variant": how.name,
                            "recording": one.name, "kind": one.kind, "split": one.split, **row,
                        }
                        for row in reconstruction_rows(
                            one, how, setup.out / "reconstructions", label=label
                        )
                    ]  # fmt: skip
                    progress(f"{how.name}, {one.name}: {rows[-1].get('error') or 'measured'}\n")
    # Beside the tracker's rows, which are measured before and after its final alignment.
    return [
        {**row, "stage": stage}
        for row in rows
        for stage in (("before", "after") if "error" not in row else ("after",))
    ]


def weights_of_garments(setup: Setup) -> dict[str, Path]:
    """Return weights by garment; the token network's serve every other one of the benchmark."""
    paths = setup.options.weights
    if setup.smoke and not paths:
        return {"towel": tiny_network(setup.out / "tiny.safetensors")}
    found = {kind: path for path in paths if (kind := kind_of(path)) != ANY_GARMENT}
    tokens = [path for path in paths if kind_of(path) == ANY_GARMENT]
    kinds = dict.fromkeys(one.kind for one in trajectories(setup.bench)) if tokens else ()
    return found | {kind: tokens[-1] for kind in kinds if kind not in found}


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--weights", type=Path, nargs="+", default=[], help="one per garment")
    parser.add_argument("--held-out", type=int, help="so many of a folder without splits")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return write_table("network_alone", __doc__, make, arguments, _add_options)


if __name__ == "__main__":
    sys.exit(main())
