"""Compare the paper's calibration, its printed grid in open loop, with descent over our axes.

The paper prints stiffness 0.2 to 1.6 in 5 steps and both frictions 0.5 to 5 in 6 steps each: 180
combinations for every action, each rolled out and compared with the last cloud. Its stiffness is
the simulator's own number without a unit; here a stiffness s is a bend compliance of 1 / s. All the
time goes into roll-outs, whose cost on a CPU does not fall with the width of a batch: 7 to 60
minutes for three actions at 1,500 vertices.

    python experiments printed_grid --bench OUT --split dev --limit 6

Runs are kept one by one; `--limit 1`, then 2, and so on prints the recordings that are finished.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import _path  # noqa: F401
import numpy as np
from shared.experiment import Run, Setup, run_experiment

from clothtrack.tracking.configuration import mode
from clothtrack.tracking.search import SearchConfig

STIFFNESS = np.linspace(0.2, 1.6, 5)
FRICTION = tuple(np.linspace(0.5, 5.0, 6).tolist())
PRINTED = {
    "bend_compliance": tuple((1.0 / STIFFNESS).tolist()),
    "table_friction": FRICTION,
    "particle_friction": FRICTION,
}
"""5 x 6 x 6."""


def plan(setup: Setup) -> list[Run]:
    """The paper's mode with either search, one recording after the other."""
    paper = mode("paper")
    printed = replace(paper, search=SearchConfig(method="grid", axes=PRINTED))
    variants = [setup.variant("descent", paper), setup.variant("printed grid", printed)]
    return [(each, variant) for each in setup.trajectories() for variant in variants]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return run_experiment("printed_grid", __doc__, plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
