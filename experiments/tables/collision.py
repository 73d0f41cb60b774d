"""Measure vertex pairs under 5 mm and true crossings, with and without the rigidity loss.

Claim judged: without rigidity the alignment pushes layers through each other. The paper counts
vertex pairs nearer than 5 mm on 3,906 vertices; ours leave out neighbors in the mesh, stand per
1,000 vertices too, and beside what the truth has on the same vertices: folded cloth is near itself.
Crossings are edges that pass through a triangle: the true fault. The default has a second term that
keeps shape, the edge lengths, so it loses that too in its last line.

    python experiments collision --bench OUT --split test --workers 2
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import _path  # noqa: F401
from shared.experiment import Run, Setup, run_experiment

from clothtrack.tracking.configuration import RunConfig, mode


def plan(setup: Setup) -> list[Run]:
    """Two methods, with and without what keeps the correction smooth."""
    paper, default = mode("paper"), mode("default")
    variants = [
        setup.variant("paper, with rigidity", paper),
        setup.variant("paper, without rigidity", weighted(paper, rigidity_weight=0.0)),
        setup.variant("default, with rigidity", default),
        setup.variant("default, without rigidity", weighted(default, rigidity_weight=0.0)),
        setup.variant(
            "default, without rigidity and edge lengths",
            weighted(default, rigidity_weight=0.0, length_weight=0.0),
        ),
    ]
    return [(each, variant) for each in setup.trajectories() for variant in variants]


def weighted(config: RunConfig, **weights: float) -> RunConfig:
    """Return the settings with these weights in the objective of both alignments."""
    return replace(config, objective=replace(config.objective, **weights))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return run_experiment("collision", __doc__, plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
