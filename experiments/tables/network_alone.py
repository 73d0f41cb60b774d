"""Measure the network alone, next to Table 1: each action's last frame reconstructed by itself.

The paper's table has it at 3.0 (1e-4 m^2). Both ways to a mesh (the token network has one), each
with and without fine-tuning at test time. Nothing is tracked: there is no TTO2, so that both of its
sides show the same mesh.

    python experiments network_alone --bench OUT --weights TOWEL TSHIRT --split test
"""

import sys
from collections.abc import Sequence

import _path  # noqa: F401
from shared.bench_measures import Row
from shared.learning_experiment import LearningSetup, refined, run_learning
from shared.learning_runs import Reconstructor, kind_of

METHODS = "template", "implicit"


def plan(setup: LearningSetup) -> list[Row]:
    """Every way on every trajectory."""
    rows = []
    for kind, weights in setup.weights.items():
        for method in METHODS if kind_of(weights) == kind else METHODS[:1]:
            how = Reconstructor(f"network, {method}", weights, method)
            for each in (how, refined(how, f"{how.name}, fine-tuned at test time")):
                rows += setup.rows("network_alone", each, setup.held_out(kind))
    # Beside the tracker's rows, which are measured before and after its final alignment.
    return [
        {**row, "stage": stage}
        for row in rows
        for stage in (("before", "after") if "error" not in row else ("after",))
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return run_learning("network_alone", __doc__, plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
