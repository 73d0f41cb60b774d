"""Compare online calibration per action with offline calibration once for all.

Claim judged: parameters found on the action that is being tracked beat parameters found before. The
offline parameters are the most frequent choice of the online calibration, parameter by parameter,
over the actions of the `dev` split; in a folder without splits, of the first nine tenths of each
garment's recordings, and the last tenth is measured. Two controls read the truth, and are no
results: friction as the world has it, in place of a search for it, and the thickness of the world's
cloth. They show the benefit of a perfect calibration.

    python experiments calibration --bench OUT --split test --workers 2
"""

import json
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

import _path  # noqa: F401
import numpy as np
from shared.bench_measures import Row
from shared.bench_runs import BENCH_FILE, Trajectory, Variant
from shared.experiment import Run, Setup, run_experiment
from shared.held_out import parted, require_apart

from clothtrack.tracking.configuration import RunConfig, mode
from clothtrack_lab.world.flex import CONTACT_RADIUS_M

FRICTION = {"table_friction": "table_friction", "particle_friction": "cloth_friction"}
"""What the tracker calls it, and what the world does."""

FITTED_ON = "dev"

METHODS = {"paper": "paper", "default": "default"}


def plan(setup: Setup) -> list[Run]:
    """Online over `dev` first, for the modes; then online, offline and uncalibrated."""
    learned, measured = chosen(setup)
    variants = []
    for label, name in METHODS.items():
        online = setup.variant(f"{label}, online", name)
        dev = setup.rows("calibration", [(each, online) for each in learned])
        offline = fixed(mode(name), most_frequent(dev))
        variants += [
            online,
            setup.variant(f"{label}, offline", offline),
            setup.variant(f"{label}, uncalibrated", fixed(mode(name), {})),
        ]
    return [(each, variant) for each in measured for variant in (*variants, *controls(setup, each))]


def chosen(setup: Setup) -> tuple[list[Trajectory], list[Trajectory]]:
    """Return the trajectories for offline calibration, and those to measure."""
    if setup.smoke:
        # One towel for both: that everything runs is all that is asked.
        return setup.trajectories(), setup.trajectories()
    if not (setup.bench / BENCH_FILE).exists():
        learned, measured = parted(setup.trajectories())
    else:
        learned, measured = setup.trajectories(FITTED_ON), setup.trajectories()
        if setup.split is None:
            measured = [one for one in measured if one.split != FITTED_ON]
    require_apart((one.recording for one in learned), (one.recording for one in measured))
    return learned, measured


def controls(setup: Setup, trajectory: Trajectory) -> list[Variant]:
    """Return the default with the true friction, and with the true thickness."""
    default, fabric = mode("default"), true_fabric(trajectory)
    kept = {axis: v for axis, v in default.search.axes.items() if axis not in FRICTION}
    friction = {name: fabric[true_name] for name, true_name in FRICTION.items()}
    known_friction = replace(
        default,
        cloth=replace(default.cloth, **friction),
        search=replace(default.search, axes=kept),
    )
    thickness_m = 2.0 * fabric.get("contact_radius_m", CONTACT_RADIUS_M)
    known_thickness = replace(default, cloth=replace(default.cloth, thickness_m=thickness_m))
    control = setup.variant("default, true friction", known_friction)
    if setup.smoke:
        # The short calibration of a smoke run searches friction, which is given here.
        control = replace(control, config=fixed(known_friction, {}))
    return [control, setup.variant("default, true thickness", known_thickness)]


def true_fabric(trajectory: Trajectory) -> dict[str, float]:
    """Return what the world's cloth is made of, as its truth file states it."""
    with np.load(trajectory.truth) as truth:
        return json.loads(str(truth["fabric"]))


def fixed(config: RunConfig, parameters: dict[str, float]) -> RunConfig:
    """Return the settings with these parameters of the cloth and no search.

    The number of layers that a picker takes is not a property of the cloth, so it keeps the mode's
    initial value.
    """
    cloth = {name: value for name, value in parameters.items() if hasattr(config.cloth, name)}
    return replace(
        config, cloth=replace(config.cloth, **cloth), search=replace(config.search, method="none")
    )


def most_frequent(rows: Iterable[Row]) -> dict[str, float]:
    """Return the mode of each parameter over all actions; the smaller of equally frequent ones."""
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
