"""Tracking time of a whole pick-and-place, by part.

A 42-step fold of a two-layer T-shirt (2.1 s at 20 Hz; see staged_fold.py) goes through the same
`Tracker` as any recording, in default mode without calibration, with clouds from the pictures on
disk. The CPU time of the process is the median over repeats, split into predict (dynamics), observe
(read, segment, thin), align (visibility and test-time optimization), correct (dynamics with the
correction) and the rest (first state, final alignment, visibility of the result). Run with
`OMP_NUM_THREADS=1`.

    python benchmarks/bench_tracking.py --json out/bench_tracking.json [--quick]
"""

import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from harness import run_benchmark
from staged_fold import FILMED_VERTICES, FRAME_RATE, STEPS, shirt, staged

from clothtrack.geometry.chamfer import one_way
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.point_cloud import Observation, observe
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.methods import Assembled, Components, default
from clothtrack.tracking.search import SearchConfig
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory
from clothtrack.tracking.tracker import Tracker

RECORDED_S = STEPS / FRAME_RATE
SOLVERS = ("adam", "icp")


class TimedEyes:
    """An observer of frames that sums its CPU time [s]."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._seen: dict[int, Observation] = {}
        self.spent_s = 0.0

    def __call__(self, frame: Frame) -> Observation:
        """Return the cloud of a frame; the last one is kept, as the pipeline does."""
        if frame.index not in self._seen:
            start = time.process_time()
            self._seen = {frame.index: observe(self._recording, frame)}
            self.spent_s += time.process_time() - start
        return self._seen[frame.index]


def one_pass(components: Components, solver: str) -> Assembled:
    """Return the default method; with Adam in place of Gauss-Newton, 400 steps of it."""
    assembled = default(components)
    method, aligner = assembled.method, assembled.method.align
    if solver == aligner.alignment.solver:
        return assembled
    aligner = replace(aligner, alignment=replace(aligner.alignment, solver=solver, iterations=400))
    last = replace(method.align_last, align=aligner)
    return replace(assembled, method=replace(method, align=aligner, align_last=last))


def tracked(
    recording: Recording, mesh: ClothMesh, solver: str
) -> tuple[dict[str, float], TrackedTrajectory]:
    """Track one recording once; return CPU seconds by part, and the result."""
    eyes = TimedEyes(recording)
    start = time.process_time()
    config = RunConfig(search=SearchConfig(method="none"))
    tracker = Tracker(recording, mesh, config, eyes, assemble=partial(one_pass, solver=solver))
    built = time.process_time()
    result = tracker.track()
    total = time.process_time() - built
    steps = result.steps
    parts = {name: float(np.nansum(getattr(steps, f"{name}_s"))) for name in ("predict", "correct")}
    parts["observe"] = eyes.spent_s
    parts["align"] = float(np.nansum(steps.align_s))
    parts["rest"] = total - sum(parts.values())
    return {"total": total, "construction": built - start, **parts}, result


def case(recording: Recording, vertex_count: int, solver: str, repeats: int) -> dict[str, object]:
    """Return one row: medians over the repeats, after a run that compiles and fills the caches."""
    mesh = shirt(vertex_count)
    tracked(recording, mesh, solver)
    runs, result = [], None
    for _ in range(repeats):
        seconds, result = tracked(recording, mesh, solver)
        runs.append(seconds)
    assert result is not None
    cloud = observe(recording, recording.frames[-1]).points
    seen = result.positions[-1][result.visible[-1]].astype(np.float64)
    return {
        "vertices": mesh.vertex_count,
        "spacing_mm": 1e3 * float(np.median(mesh.edge_lengths)),
        "solver": solver,
        "seconds": {name: float(np.median([run[name] for run in runs])) for name in runs[0]},
        "times_recording": float(np.median([run["total"] for run in runs])) / RECORDED_S,
        "trials": int(result.steps.trials.sum()),
        "gave_up": int(result.steps.gave_up.sum()),
        "last_cloud_rms_mm": 1e3 * float(np.sqrt(one_way(cloud, seen))),
    }


def measure(folder: Path, quick: bool) -> dict[str, object]:
    """Record, and track at every size with both solvers."""
    counts, repeats = ([1000], 1) if quick else ([1000, 4000], 3)
    recording = staged(folder / "fold")
    rows = [case(recording, count, solver, repeats) for count in counts for solver in SOLVERS]
    return {
        "filmed_vertices": FILMED_VERTICES, "recorded_s": RECORDED_S, "repeats": repeats,
        "rows": rows,
    }  # fmt: skip


if __name__ == "__main__":
    run_benchmark("tracking", __doc__, measure)
