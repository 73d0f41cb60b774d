"""Measure the sensitivity of the default: one setting at a time, everything else unchanged.

Claim judged: no value in the configuration is a lucky choice, and the limits of the tracker are
known. The axes, each of them a name for `--axes`:

- rigidity: weight of the rigidity loss in both alignments.
- explosion: speed [m/s] above which the line search takes a correction back, and nothing else does.
- vertices: first mesh resampled to about so many.
- thickness: distance that the tracker keeps layers apart [mm].
- cloud: one cloud point per cube of this size [mm].
- first mesh: its deviation from the truth times this; 0 is the truth (a control, not a result).
- noise: the camera's noise times this; filmed anew, same cloth and same actions.
- actions: one trajectory of six pick-and-places per garment and seed; the rows are per action.

    python experiments sensitivity --bench OUT --split dev --limit 8 --axes thickness cloud
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace

import _path  # noqa: F401
from shared.ablations import EXPLOSION_M_S
from shared.experiment import Run, Setup, run_experiment

from clothtrack.tracking.configuration import RunConfig, mode
from tables.collision import weighted

RIGIDITY = (0.0, 1.0, 10.0, 100.0)
VERTICES = (500, 1000, 2000, 4000)
THICKNESS_MM = (1.0, 2.0, 3.0, 5.0)
CLOUD_MM = (2.0, 4.0, 8.0, 16.0)
FIRST_MESH = (0.0, 1.0, 2.0, 4.0)
NOISE = (0.0, 1.0, 2.0, 4.0)
ACTIONS = 6
AXES = ("rigidity", "explosion", "vertices", "thickness", "cloud", "first mesh", "noise", "actions")


def plan(setup: Setup) -> list[Run]:
    """Every value of the chosen axes; a smoke run takes the first two of each."""
    default = mode("default")
    runs: list[Run] = []
    for axis in setup.options.axes:
        if axis == "noise":
            runs += _noise(setup)
        elif axis == "actions":
            runs += _actions(setup)
        else:
            for variant in _few(setup, _variants(setup, default, axis)):
                runs += [(each, variant) for each in setup.trajectories()]
    return runs


def _variants(setup: Setup, default: RunConfig, axis: str) -> list:
    if axis == "rigidity":
        return [
            setup.variant(f"rigidity={value:g}", weighted(default, rigidity_weight=value))
            for value in _with(RIGIDITY, default.objective.rigidity_weight)
        ]
    if axis == "explosion":
        return [
            setup.variant(f"explosion={value:g} m/s", default, f"exploding_at_{value:g}")
            for value in EXPLOSION_M_S
        ]
    if axis == "vertices":
        counts = (120, 200) if setup.smoke else VERTICES
        return [setup.variant(f"vertices={count}", default, vertex_count=count) for count in counts]
    if axis == "thickness":
        return [
            setup.variant(
                f"thickness={value:g} mm",
                replace(default, cloth=replace(default.cloth, thickness_m=1e-3 * value)),
            )
            for value in _with(THICKNESS_MM, 1e3 * default.cloth.thickness_m)
        ]
    if axis == "cloud":
        return [
            _thinned(setup, default, value)
            for value in _with(CLOUD_MM, 1e3 * RunConfig().cloud_spacing_m)
        ]
    return [
        setup.variant(f"first mesh={value:g}", default, first_mesh_error=value)
        for value in FIRST_MESH
    ]


def _thinned(setup: Setup, config: RunConfig, spacing_mm: float):
    return setup.variant(
        f"cloud={spacing_mm:g} mm", replace(config, cloud_spacing_m=1e-3 * spacing_mm)
    )


def _noise(setup: Setup) -> list[Run]:
    sensor = setup.world.sensor
    runs: list[Run] = []
    for factor in _few(setup, list(NOISE)):
        noisy = replace(sensor, white_m=factor * sensor.white_m, wave_m=factor * sensor.wave_m)
        filmed = setup.filmed(f"noise_{factor:g}", replace(setup.world, sensor=noisy))
        variant = setup.variant(f"noise={factor:g}", "default")
        runs += [(each, variant) for each in filmed]
    return runs


def _actions(setup: Setup) -> list[Run]:
    count = 2 if setup.smoke else ACTIONS
    filmed = setup.filmed(f"actions_{count}", replace(setup.world, actions=count))
    variant = setup.variant(f"actions=1 to {count}", "default")
    return [(each, variant) for each in filmed]


def _with(values: Sequence[float], default: float) -> list[float]:
    """Return the axis with the default on it, whatever that is by now."""
    return sorted({*values, round(default, 6)})


def _few(setup: Setup, values: list) -> list:
    return values[:2] if setup.smoke else values


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    return run_experiment("sensitivity", __doc__, plan, arguments, _add_options)


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--axes", nargs="+", choices=AXES, default=list(AXES))


if __name__ == "__main__":
    sys.exit(main())
