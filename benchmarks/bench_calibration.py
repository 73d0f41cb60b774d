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

import argparse
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from bench_tracking import TimedEyes
from results import provenance, write_json
from staged_fold import FILMED, shirt, staged

from clothtrack.geometry import quiet_warp
from clothtrack.recordings import Recording
from clothtrack.tracking import Components, RunConfig, SearchConfig
from clothtrack.tracking.configuration import PAPER_AXES

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
    start = time.process_time()
    search = components.open_loop_calibration()(action, state, config.cloth.theta(held_layers=0))
    (candidate,) = search
    record = search.calibration
    return {
        "vertices": mesh.vertex_count,
        "method": method,
        "combinations": int(np.prod([len(values) for values in axes.values()])),
        "roll_outs": record.roll_outs,
        "seconds": time.process_time() - start,
        "chamfer_m2": float(np.min(record.scores)),
        "chosen": {name: getattr(candidate.theta, name) for name in axes},
    }


def table(rows: list[dict]) -> str:
    """Return the rows as text, with costs and results next to those of the grid."""
    grids = {row["vertices"]: row for row in rows if row["method"] == "grid"}
    lines = []
    for row in rows:
        grid = grids[row["vertices"]]
        values = " ".join(f"{name} {value:g}" for name, value in row["chosen"].items())
        lines.append(
            f"{row['vertices']:5d} vertices {row['method']:8} {row['roll_outs']:5.1f} roll-outs of "
            f"{row['combinations']}  {row['seconds']:7.1f} s "
            f"(x{grid['seconds'] / row['seconds']:4.1f})  {1e6 * row['chamfer_m2']:7.3f} mm^2 "
            f"({100 * (row['chamfer_m2'] / grid['chamfer_m2'] - 1):+5.1f} %)  {values}"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Record once, search with every method at every size, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, required=True, help="where the result goes")
    parser.add_argument("--quick", action="store_true", help="1,000 vertices, 27 combinations")
    options = parser.parse_args()
    quiet_warp()
    full = PAPER_AXES
    sizes = {1000: SMALL_AXES} if options.quick else {1000: full, 4000: SMALL_AXES}
    rows = []
    with tempfile.TemporaryDirectory(prefix="bench-calibration-") as folder:
        recording = staged(Path(folder) / "fold")
        for vertex_count, axes in sizes.items():
            for method in METHODS:
                rows.append(searched(recording, vertex_count, method, axes))
                sys.stderr.write(table([*rows[-1:], *rows]).splitlines()[0] + "\n")
    write_json(
        options.json,
        {
            "benchmark": "calibration",
            "filmed_with": vars(FILMED),
            "axes": {str(size): axes for size, axes in sizes.items()},
            "rows": rows,
            "provenance": provenance(),
        },
    )
    sys.stdout.write(table(rows))


if __name__ == "__main__":
    main()
