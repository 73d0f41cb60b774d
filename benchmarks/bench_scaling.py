"""Cost of a trajectory by vertices, frames and candidates.

The T-shirt of staged_fold.py is tracked at several numbers of vertices: in default mode without
calibration, with half of its frames, and with candidates. CPU time is that of the process
(`time.process_time`), after a run that compiles. Memory is the peak of the process. Bytes and files
are those of the saved trajectory.

    python benchmarks/bench_scaling.py --json out/bench_scaling.json [--quick]
"""

import resource
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from harness import run_benchmark
from staged_fold import SIZE_M, STEPS, shirt, staged

from clothtrack.recordings.point_cloud import observe
from clothtrack.recordings.recording import Recording
from clothtrack.tracking.configuration import RunConfig
from clothtrack.tracking.search import SearchConfig
from clothtrack.tracking.tracker import Tracker

AXES = {"table_friction": (0.3, 1.0, 3.0)}
"""Candidates where there are some: three, each tracked to the end of the action."""


def configured(*, candidates: bool) -> RunConfig:
    """Return the default mode, with few candidates or none."""
    return RunConfig(search=SearchConfig(axes=AXES) if candidates else SearchConfig(method="none"))


def shortened(recording: Recording, steps: int) -> Recording:
    """Return the first steps of a recording with one action."""
    action = replace(recording.actions[0], last_frame=steps)
    return replace(recording, frames=recording.frames[: steps + 1], actions=(action,))


def row(recording: Recording, vertex_count: int, *, candidates: bool, folder: Path) -> dict:
    """Return one row for a trajectory: CPU seconds, memory, bytes and files."""
    mesh = shirt(vertex_count)
    start = time.process_time()
    result = Tracker(
        recording, mesh, configured(candidates=candidates), partial(observe, recording)
    ).track()
    tracked_s = time.process_time() - start
    saved = folder / f"{vertex_count}_{len(recording.frames)}_{candidates}.zarr"
    result.save(saved)
    files = [path for path in saved.rglob("*") if path.is_file()]
    return {
        "vertices": mesh.vertex_count,
        "frames": len(recording.frames),
        "candidates": float(result.actions[0].calibration.roll_outs),
        "cpu_s": round(tracked_s, 3),
        "save_s": round(time.process_time() - start - tracked_s, 3),
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "bytes": sum(path.stat().st_size for path in files),
        "disk_bytes": sum(512 * path.stat().st_blocks for path in saved.rglob("*")),
        "files": len(files),
        "entries": sum(1 for _ in saved.rglob("*")) + 1,
    }


def fitted(rows: list[dict]) -> dict[str, float]:
    """Fit CPU seconds = frames (per frame + vertices per vertex) (1 + candidates share)."""
    plain = [one for one in rows if not one["candidates"]]
    searched = [one for one in rows if one["candidates"]]
    frames = np.array([one["frames"] for one in plain], dtype=float)
    vertices = np.array([one["vertices"] for one in plain], dtype=float)
    spent = np.array([one["cpu_s"] for one in plain])
    columns = np.stack([frames, frames * vertices], axis=1)
    # Relative errors count: the largest trajectory must not decide alone.
    solution, *_ = np.linalg.lstsq(columns / spent[:, None], np.ones(len(plain)), rcond=None)
    model = dict(zip(("per_frame_s", "per_frame_and_vertex_s"), map(float, solution), strict=True))
    shares = []
    for one in searched:
        (same,) = [other for other in plain if other["frames"] == one["frames"]
                   and other["vertices"] == one["vertices"]]  # fmt: skip
        shares.append((one["cpu_s"] / same["cpu_s"] - 1.0) / one["candidates"])
    misses = columns @ solution / spent - 1.0
    return {**model, "share_of_a_candidate": float(np.mean(shares)),
            "largest_miss": float(np.abs(misses).max())}  # fmt: skip


def measure(folder: Path, quick: bool) -> dict[str, object]:
    """Record once, and track at every size."""
    counts = [250, 500] if quick else [250, 500, 1000, 2000]
    whole = staged(folder / "fold")
    half = shortened(whole, STEPS // 2)
    row(shortened(whole, 2), counts[0], candidates=True, folder=folder / "first")
    rows = [row(half, count, candidates=False, folder=folder) for count in counts]
    rows.append(row(whole, counts[1], candidates=False, folder=folder))
    rows.append(row(half, counts[1], candidates=True, folder=folder))
    return {"size_m": SIZE_M, "rows": rows, "model": fitted(rows)}


if __name__ == "__main__":
    run_benchmark("scaling", __doc__, measure)
