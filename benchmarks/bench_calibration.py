"""Cost and quality of cloth parameter calibration, by method.

There is one action, the fold of a two-layer T-shirt from staged_fold.py. Every method searches the
same axes from the same start, with clouds from the pictures on disk. A roll-out counts by the share
of the action that it simulates. The CPU time is that of one calibration, including observation of
the scored frames. The score is the tracker's: the two-way masked Chamfer distance [m^2] of the
open-loop roll-out. The recorded cloth has another triangulation, so no candidate scores zero.

    python benchmarks/bench_calibration.py --json out/bench_calibration.json [--quick]

The axes are the tracker's own at 1,000 vertices; at 4,000, and with --quick, three of the cloth's
properties have three values each (27 combinations). Run with `OMP_NUM_THREADS=1`.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from bench_tracking import TimedEyes
from harness import run_benchmark, timed
from staged_fold import FILMED, shirt, staged

from clothtrack.recordings.recording import Recording
from clothtrack.tracking.configuration import PAPER_AXES, RunConfig
from clothtrack.tracking.methods import Components
from clothtrack.tracking.search import SearchConfig

METHODS = ("grid", "descent")
SMALL_AXES: Mapping[str, tuple[float, ...]] = {
    "bend_compliance": (0.1, 1.0, 10.0),
    "table_friction": (0.2, 0.5, 1.0),
    "particle_friction": (0.2, 0.5, 1.0),
}


def searched(
    recording: Recording, vertex_count: int, method: str, axes: Mapping[str, tuple[float, ...]]
) -> dict[str, object]:
    """Return one row: one calibration of one action, kernels compiled before."""
    config = RunConfig(search=SearchConfig(method=method, axes=axes))
    eyes = TimedEyes(recording)
    components = Components(recording, shirt(vertex_count), config, eyes)
    mesh, action = components.mesh, recording.actions[0]
    state = components.simulator(velocity_kept=1.0).solver.save()
    calibrate, theta = components.open_loop_calibration(), config.cloth.theta(held_layers=0)
    seconds, search = timed(lambda: calibrate(action, state, theta))
    (candidate,) = search
    record = search.calibration
    return {
        "vertices": mesh.vertex_count,
        "method": method,
        "combinations": int(np.prod([len(values) for values in axes.values()])),
        "roll_outs": record.roll_outs,
        "seconds": seconds,
        "chamfer_m2": float(np.min(record.scores)),
        "chosen": {name: getattr(candidate.theta, name) for name in axes},
    }


def measure(folder: Path, quick: bool) -> dict[str, object]:
    """Record once, search with every method at every size."""
    sizes = {1000: SMALL_AXES} if quick else {1000: PAPER_AXES, 4000: SMALL_AXES}
    recording = staged(folder / "fold")
    rows = [
        searched(recording, count, method, axes)
        for count, axes in sizes.items()
        for method in METHODS
    ]
    return {"filmed_with": vars(FILMED), "axes": sizes, "rows": rows}


if __name__ == "__main__":
    run_benchmark("calibration", __doc__, measure)
