"""Speed of test-time optimization against a plain implementation in torch with a k-d tree.

The peer builds a new k-d tree in every iteration. Both minimize the same objective from the same
start, in the same run, with one thread. Times are medians of CPU time. Run with
`OMP_NUM_THREADS=1`. The ratio is how many times faster clothtrack is; the gap is how far its final
objective lies above the peer's (negative: below).

    python benchmarks/bench_alignment.py --json alignment.json [--quick]
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from harness import run_benchmark, timed
from scipy.spatial import cKDTree

from clothtrack.alignment.aligner import AlignmentConfig, CloudAligner
from clothtrack.alignment.solvers import ADAM_STEP_M
from clothtrack.alignment.terms_kernels import TWO_WAY_RANGE_M
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import visible_vertices

OBJECTIVES = {
    # Without the stiff length term, icp gets along with half of the inner steps.
    "paper": AlignmentConfig(two_way_weight=0.0, length_weight=0.0, icp_inner=6, icp_momentum=1.0),
    "two-way and length": AlignmentConfig(),
}
ITERATIONS = {"adam": 200, "icp": 8}
SIZES = {"1,000": (33, 0.32, 2000), "1,500": (39, 0.38, 1700), "4,000": (64, 0.35, 3800)}


def folded_cloth(
    count: int, size_m: float, points: int
) -> tuple[ClothMesh, np.ndarray, np.ndarray, np.ndarray]:
    """Return a folded square cloth, and its cloud after a slightly different fold and shift."""
    side = np.linspace(-size_m / 2, size_m / 2, count)
    x, y = np.meshgrid(side, side, indexing="ij")
    flat = np.stack([x.ravel(), y.ravel(), np.zeros(count**2)], 1)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    one = np.stack([corner, corner + count, corner + 1], 1)
    other = np.stack([corner + 1, corner + count, corner + count + 1], 1)
    mesh = ClothMesh(flat, np.concatenate([one, other]))

    def fold(at: float) -> np.ndarray:
        folded = flat.copy()
        over = folded[:, 0] > at
        folded[over, 0] = 2 * at - folded[over, 0]
        folded[:, 2] = 0.004 + 0.006 * np.sin(20 * folded[:, 0]) * np.sin(17 * folded[:, 1])
        folded[over, 2] += 0.01
        return folded

    camera = Camera("top", 320, 320, 500.0, 500.0, 159.5, 159.5, _looking_down(0.65))
    predicted, truth = fold(0.06), fold(0.064) + np.array([0.004, -0.003, 0.003])
    visible = visible_vertices(predicted, mesh.faces, [camera])
    seen = mesh.faces[visible_vertices(truth, mesh.faces, [camera])[mesh.faces].all(axis=1)]
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(3), points)
    cloud = np.einsum("pi,pij->pj", weights, truth[seen[rng.integers(len(seen), size=points)]])
    return mesh, predicted, cloud + rng.normal(scale=0.001, size=cloud.shape), visible


def _looking_down(height_m: float) -> np.ndarray:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = height_m
    return pose


def peer(
    mesh: ClothMesh,
    positions: np.ndarray,
    cloud: np.ndarray,
    visible: np.ndarray,
    config: AlignmentConfig,
) -> float:
    """Minimize the same objective with torch's autograd and Adam, with a k-d tree per iteration."""
    start, points = torch.tensor(positions), torch.tensor(cloud)
    first, second = torch.tensor(mesh.edges.T.astype(np.int64))
    rest = torch.tensor(mesh.edge_lengths)
    seen, tree = np.flatnonzero(visible), cKDTree(cloud)
    displacement = torch.zeros_like(start, requires_grad=True)
    optimizer = torch.optim.Adam([displacement], lr=ADAM_STEP_M)

    def objective() -> torch.Tensor:
        now = start + displacement
        where = now.detach().numpy()[seen]
        nearest = torch.from_numpy(seen[cKDTree(where).query(cloud)[1]])
        loss = config.chamfer_weight * (points - now[nearest]).square().sum(1).mean()
        difference = displacement[first] - displacement[second]
        loss = loss + config.rigidity_weight * difference.square().sum(1).mean()
        if config.two_way_weight:
            distance, partner = tree.query(where)
            low, high = TWO_WAY_RANGE_M
            counts = (distance >= low) & (distance <= high)
            miss = now[torch.from_numpy(seen[counts])] - points[torch.from_numpy(partner[counts])]
            if counts.any():
                loss = loss + config.two_way_weight * miss.square().sum(1).mean()
        if config.length_weight:
            lengths = (now[first] - now[second]).norm(dim=1)
            loss = loss + config.length_weight * (lengths - rest).square().mean()
        return loss

    for _ in range(config.iterations):
        optimizer.zero_grad()
        objective().backward()
        optimizer.step()
    return float(objective().detach())


def compare(size: str, objective: str, *, repeats: int) -> dict[str, object]:
    """Return one row: peer, Adam and icp on one problem."""
    config = OBJECTIVES[objective]
    mesh, positions, cloud, visible = folded_cloth(*SIZES[size])
    solvers = {
        solver: CloudAligner(mesh, replace(config, solver=solver, iterations=iterations))
        for solver, iterations in ITERATIONS.items()
    }

    def solve(solver: str) -> float:
        return float(solvers[solver].align(positions, cloud, visible).losses[-1])

    for solver in solvers:
        solve(solver)  # compiles the kernels
    peer_s, peer_loss = timed(lambda: peer(mesh, positions, cloud, visible, config), repeats)
    row = {
        "objective": objective,
        "vertices": mesh.vertex_count,
        "visible": int(visible.sum()),
        "points": len(cloud),
        "peer_ms": 1e3 * peer_s,
    }
    for solver in solvers:
        seconds, loss = timed(lambda solver=solver: solve(solver), 5 * repeats)
        row[f"{solver}_ms"] = 1e3 * seconds
        row[f"{solver}_ratio"] = peer_s / seconds
        row[f"{solver}_objective_gap"] = loss / peer_loss - 1
    return row


def measure(_: Path, quick: bool) -> dict[str, object]:
    """Return a row for every size and objective."""
    torch.set_num_threads(1)
    sizes = list(SIZES)[:1] if quick else SIZES
    cases = [(size, objective) for size in sizes for objective in OBJECTIVES]
    return {"rows": [compare(*case, repeats=1 if quick else 3) for case in cases]}


if __name__ == "__main__":
    run_benchmark("alignment", __doc__, measure)
