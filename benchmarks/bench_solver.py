"""Speed of the cloth solver and its peers: CPU time per 10 ms of simulated time.

A two-layer T-shirt lies on a table, with its layers in contact from the first step on, and one
vertex of the front is lifted. All engines run in this process, one after the other, so that their
ratios are valid on a busy machine too. CPU time is the sum over all threads, not wall time.

    python benchmarks/bench_solver.py --json out/bench_solver.json [--quick]

In the result, `worst_ratio` is the CPU time of the *fastest* peer over ours, at the size where it
is smallest. `layers_mm` and `edge_strain` show whether an engine still simulates a cloth. They are
the median distance from a front vertex to the back, before and after, and the mean relative change
of edge length.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from engines import PEERS, Engine, Ours
from harness import run_benchmark
from scipy.spatial import KDTree

from clothtrack.files.extras import install_command
from clothtrack.garments.garment_meshes import garment, tshirt
from clothtrack.geometry.mesh import ClothMesh

LAYER_GAP_M = 0.003
LIFT_PER_STEP_M = 0.004


def shirt(vertex_count: int) -> ClothMesh:
    """Return a T-shirt of about so many vertices, flat, 2 mm above the table, layers 3 mm apart."""
    spacing = float(np.median(garment("tshirt", vertex_count=vertex_count).edge_lengths))
    flat = tshirt(spacing_m=spacing, layer_gap_m=LAYER_GAP_M)
    lift = 0.002 - flat.vertices[:, 2].min()
    return flat.with_vertices(flat.vertices + (0.0, 0.0, lift))


def layer_distance_mm(mesh: ClothMesh, positions: np.ndarray) -> float:
    """Return the median distance [mm] from a vertex of the front to the nearest of the back."""
    side = mesh.canonical[:, 2]
    deep = 0.5 * np.abs(side).max()
    front, back = positions[side > deep], positions[side < -deep]
    return 1e3 * float(np.median(KDTree(back).query(front)[0]))


def edge_strain(mesh: ClothMesh, positions: np.ndarray) -> float:
    """Return the mean absolute relative change of edge length."""
    ends = positions[mesh.edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return float(np.abs(lengths / mesh.edge_lengths - 1.0).mean())


def measure(
    build: Callable[[ClothMesh, int], Engine], mesh: ClothMesh, *, warm_up: int, steps: int
) -> dict[str, float]:
    """Return CPU time per 10 ms [ms], median and mean over steps, and the final state."""
    held = int(np.argmin(np.linalg.norm(mesh.canonical - mesh.canonical.max(axis=0) / 2, axis=1)))
    engine = build(mesh, held)
    place = np.array(mesh.vertices[held], dtype=np.float64)
    for _ in range(warm_up):
        engine.step(place)
    before = layer_distance_mm(mesh, engine.positions())
    spent = []
    for _ in range(steps):
        place = place + (0.0, 0.0, LIFT_PER_STEP_M)
        start = time.process_time()
        engine.step(place)
        spent.append(1e3 * (time.process_time() - start))
    positions = engine.positions()
    return {
        "ms": float(np.median(spent)),
        "mean_ms": float(np.mean(spent)),
        "layers_mm_before": before,
        "layers_mm_after": layer_distance_mm(mesh, positions),
        "edge_strain": edge_strain(mesh, positions),
        "finite": bool(np.isfinite(positions).all()),
    }


def compared(folder: Path, quick: bool) -> dict[str, object]:  # noqa: ARG001
    """Measure all engines at all sizes; a peer that cannot run is skipped with its reason."""
    warm_up, steps = (2, 3) if quick else (5, 14)
    rows: list[dict[str, object]] = []
    skipped: dict[str, str] = {}
    worst = np.inf
    for count in [1000] if quick else [1000, 4000]:
        mesh = shirt(count)
        row: dict[str, object] = {"vertices": mesh.vertex_count}
        ours = measure(Ours, mesh, warm_up=warm_up, steps=steps)
        row["ours"] = ours
        for name, build in PEERS.items():
            sys.stderr.write(f"{mesh.vertex_count} vertices: {name}\n")
            try:
                peer = measure(build, mesh, warm_up=warm_up, steps=steps)
            except ImportError as error:
                skipped[name] = f"not installed ({error}); {install_command('bench')}"
                continue
            row[name] = {**peer, "over_ours": peer["ms"] / ours["ms"]}
            worst = min(worst, peer["ms"] / ours["ms"])
        rows.append(row)
    found = worst if np.isfinite(worst) else None
    return {"rows": rows, "worst_ratio": found, "skipped": skipped}


if __name__ == "__main__":
    run_benchmark("solver", __doc__, compared)
