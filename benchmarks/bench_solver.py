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

import argparse
import json
import platform
import sys
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import numpy as np
from engines import PEERS, Engine, Ours
from scipy.spatial import KDTree

from clothtrack.files.extras import install_command
from clothtrack.garments import garment, tshirt
from clothtrack.geometry import ClothMesh, quiet_warp

LAYER_GAP_M = 0.003
LIFT_PER_STEP_M = 0.004
PACKAGES = ("numpy", "warp-lang", "mujoco-core", "newton")


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


def bench(vertex_counts: list[int], *, warm_up: int, steps: int) -> dict[str, object]:
    """Measure all engines at all sizes; a peer that cannot run is skipped with its reason."""
    cases: list[dict[str, object]] = []
    skipped: dict[str, str] = {}
    worst = np.inf
    for count in vertex_counts:
        mesh = shirt(count)
        peers: dict[str, dict[str, float]] = {}
        for name, build in PEERS.items():
            tell(f"{mesh.vertex_count} vertices: {name}")
            try:
                peers[name] = measure(build, mesh, warm_up=warm_up, steps=steps)
            except ImportError as error:
                skipped[name] = f"not installed ({error}); {install_command('bench')}"
        tell(f"{mesh.vertex_count} vertices: ours")
        ours = measure(Ours, mesh, warm_up=warm_up, steps=steps)
        peers_ms = {name: result["ms"] for name, result in peers.items()}
        if peers_ms:
            worst = min(worst, min(peers_ms.values()) / ours["ms"])
        cases.append(
            {
                "vertices": mesh.vertex_count,
                "ours_ms": ours["ms"],
                "peers_ms": peers_ms,
                "details": {"ours": ours, **peers},
            }
        )
    return {
        "cases": cases,
        "worst_ratio": worst if np.isfinite(worst) else None,
        "skipped": skipped,
    }


def table(result: dict) -> str:
    """Return the cases as text."""
    names = list(PEERS)
    lines = [f"{'vertices':>8} {'ours':>8} " + " ".join(f"{n:>18}" for n in names)]
    for case in result["cases"]:
        cells = [
            f"{case['peers_ms'][n]:9.1f} (x{case['peers_ms'][n] / case['ours_ms']:6.1f})"
            if n in case["peers_ms"]
            else f"{'-':>18}"
            for n in names
        ]
        lines.append(f"{case['vertices']:8d} {case['ours_ms']:8.2f} " + " ".join(cells))
    lines.append("CPU ms per 10 ms of simulated time, layers in contact (in brackets: over ours)")
    return "\n".join(lines)


def tell(text: str) -> None:
    """Print progress on standard error."""
    sys.stderr.write(text + "\n")


def main() -> None:
    """Run, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, required=True, help="where the result goes")
    parser.add_argument("--quick", action="store_true", help="the small shirt only, few steps")
    options = parser.parse_args()
    quiet_warp()
    counts = [1000] if options.quick else [1000, 4000]
    warm_up, steps = (2, 3) if options.quick else (5, 14)
    result = bench(counts, warm_up=warm_up, steps=steps)
    installed = {}
    for name in PACKAGES:
        try:
            installed[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            installed[name] = None
    result["provenance"] = {
        "machine": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "packages": installed,
        "warm_up_steps": warm_up,
        "measured_steps": steps,
    }
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    sys.stdout.write(table(result) + "\n")


if __name__ == "__main__":
    main()
