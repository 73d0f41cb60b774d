"""Calibration online, per action, against offline, once for all.

Claim judged: parameters found on the action that is being tracked beat parameters found before. The
offline parameters are the most frequent choice of the online calibration, parameter by parameter,
over the actions of the `dev` split. In a world without splits they come from the recordings
themselves, which flatters them.

    python experiments/calibration.py --bench OUT --split test --workers 2
"""

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

from bench_measures import Row
from experiment import Run, Setup, run_experiment

from clothtrack.tracking.configuration import TrackerConfig, mode

METHODS = {"paper": "full_held_paper", "default": "default"}


def plan(setup: Setup) -> list[Run]:
    """Online over `dev` first, for the modes; then online, offline and uncalibrated."""
    variants = []
    for label, name in METHODS.items():
        online = setup.variant(f"{label}, online", name)
        dev = setup.rows("calibration", [(each, online) for each in setup.trajectories("dev")])
        offline = fixed(mode(name), most_frequent(dev))
        variants += [
            online,
            setup.variant(f"{label}, offline", offline),
            setup.variant(f"{label}, uncalibrated", fixed(mode(name), {})),
        ]
    return [(each, variant) for each in setup.trajectories() for variant in variants]


def fixed(config: TrackerConfig, parameters: dict[str, float]) -> TrackerConfig:
    """The configuration with these parameters and no search."""
    return replace(
        config,
        parameters={**config.parameters, **parameters},
        calibration=replace(config.calibration, method="none"),
    )


def most_frequent(rows: Iterable[Row]) -> dict[str, float]:
    """The mode of each parameter over all actions; the smaller value of two equally frequent."""
    counts: dict[str, Counter[float]] = {}
    for row in rows:
        # Two rows per action, before and after TTO2: one vote is enough.
        if row.get("stage") == "after":
            for name, value in row["parameters"].items():
                counts.setdefault(name, Counter())[value] += 1
    return {
        name: min(values, key=lambda value: (-values[value], value))
        for name, values in counts.items()
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return run_experiment("calibration", __doc__, plan, arguments)


if __name__ == "__main__":
    sys.exit(main())
