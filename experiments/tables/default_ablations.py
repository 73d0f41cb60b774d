"""Ablate our default, and go from the paper's method to it, one change after the other.

Claim judged: each change improves the result; and the order of the paper's Table 1, which its
method does not show on the benchmark, depends on how the visible vertices are held. The first half
starts at the paper's method and keeps every change it has made; the last one, the slide to the
outline, makes it the default. The second half takes away from the default the parts of the paper's
Table 1, then its own: the alignment of the first mesh, the mean of the candidates, the search among
them, the untangling, the rest where pictures stand still, the points followed in color, the cloth's
stretch.

    python experiments default_ablations --bench OUT --split test --workers 2
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import _path  # noqa: F401
from shared.bench_runs import Variant
from shared.experiment import Run, Setup, run_experiment

from clothtrack.tracking.configuration import mode
from clothtrack.tracking.search import SearchConfig
from tables.collision import weighted


def plan(setup: Setup) -> list[Run]:
    """Return the steps, then the ablations of where they end."""
    variants = [*steps(setup), *ablations(setup)]
    return [(each, variant) for each in setup.trajectories() for variant in variants]


def steps(setup: Setup) -> list[Variant]:
    """Return the paper's method and, one added to the other, what the default does differently."""
    paper, ours = mode("paper"), mode("default")
    losses = weighted(
        paper,
        two_way_weight=ours.objective.two_way_weight,
        length_weight=ours.objective.length_weight,
    )
    # Everything that is left but the search and the slide: release of velocity, TTO2 rolled out.
    rolled = replace(ours, cloth=paper.cloth, search=paper.search)
    return [
        setup.variant("paper", paper),
        setup.variant("+ soft attachments", paper, "soft"),
        setup.variant("+ only observed and uncrossed vertices", paper, "observed"),
        setup.variant("+ two-way loss and edge lengths", losses, "observed"),
        setup.variant("+ TTO2 carried out by the dynamics", rolled, "rolled"),
        setup.variant("+ parameters and layers searched by tracking", ours, "unslid"),
        setup.variant("default", ours),
    ]


WITHOUT = {
    "pseudo-action": "default_no_pseudo_action",
    "dynamics initialization": "default_no_dynamics_initialization",
    "action": "default_no_action",
    "TTO2": "default_no_final_alignment",
    "first alignment": "default_unaligned_first",
    "mean of candidates": "default_best_only",
    "untangling": "default_tangled",
    "rest": "default_every_frame",
}
"""What is taken away, and the method that does without it."""


def ablations(setup: Setup) -> list[Variant]:
    """Return the default without one part of the method each."""
    ours = mode("default")
    return [
        *(setup.variant(f"default without {part}", ours, name) for part, name in WITHOUT.items()),
        setup.variant("default without search", replace(ours, search=SearchConfig(method="none"))),
        setup.variant("default without color", replace(ours, color=False)),
        setup.variant(
            "default without stretch",
            replace(ours, cloth=replace(ours.cloth, stretch_compliance=0.0)),
        ),
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return run_experiment("default_ablations", __doc__, plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
