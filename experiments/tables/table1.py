"""Table 1: the paper's method, its four ablations, open loop, and our default.

Claim judged: pseudo-action, dynamics initialization, action conditioning and TTO2 each improve the
result; and the default is nearer to the truth than the paper's method. The paper could only measure
the Chamfer distance, which hardly follows the true error; both are listed here. The rows begin with
the recording's template, those "network first" with what the network makes of the first picture.

    python experiments table1 --bench OUT --split test --workers 2
"""

import sys
from collections.abc import Sequence
from dataclasses import replace

import _path  # noqa: F401
from shared.bench_runs import Variant
from shared.experiment import Run, Setup, run_experiment

METHODS = (
    "no_pseudo_action",
    "no_dynamics_initialization",
    "no_action_conditioning",
    "no_final_alignment",
    "paper",
    "open_loop",
    "default",
)
FROM_NETWORK = ("paper", "default")
"""Begun with the first mesh that the network makes of the first picture, too, as in the paper."""


def plan(setup: Setup) -> list[Run]:
    """Every method on every trajectory."""
    variants = [setup.variant(name, name) for name in METHODS]
    variants += [
        _from_network(setup.variant(f"{name}, network first", name)) for name in FROM_NETWORK
    ]
    return [(each, variant) for each in setup.trajectories() for variant in variants]


def _from_network(variant: Variant) -> Variant:
    first = replace(variant.config.initial_state, source="network")
    return replace(variant, config=replace(variant.config, initial_state=first))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return run_experiment("table1", __doc__, plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
