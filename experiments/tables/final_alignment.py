"""Compare with and without TTO2 at the best, the 50 % and the 90 % ranked grid parameters.

Claim judged: the final alignment makes up for a bad calibration. Per action every combination of
the grid is rolled out and ranked; the tracker then takes the best, the one that half of the others
outscore, or the one that 90 % outscore. The method is the paper's, the grid that of our calibration
(18 combinations; the paper prints 180).

    python experiments final_alignment --bench OUT --split test --workers 2
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import _path  # noqa: F401
from shared.ablations import RANKS
from shared.experiment import Run, Setup, run_experiment

from clothtrack.tracking.configuration import mode


def plan(setup: Setup) -> list[Run]:
    """Return three ranks, with and without TTO2."""
    paper = mode("paper")
    grid = replace(paper, search=replace(paper.search, method="grid"))
    variants = [
        setup.variant(f"{label}, {end} TTO2", grid, f"ranked_{label}_{end}_TTO2")
        for end in ("with", "without")
        for label in RANKS
    ]
    return [(each, variant) for each in setup.trajectories() for variant in variants]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return run_experiment("final_alignment", __doc__, plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
