"""Random physics on a small cloth that is picked, lifted, dragged and dropped.

Settings are drawn over what the solver permits; where a range has no end, over the decades of
`DRAWN`. Three things must hold: all numbers are finite, a free cloth gains no more energy than the
picker could have stored in it, and no vertex is deeper under the table than the cloth is thick.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from shared.trial import child_result

MOVED_S, FREE_S, SAMPLE_S = 0.3, 0.4, 0.02
"""Lift and drag last the first each, the fall the second; energy is taken every third [s]."""

LIFT_M, DRAG_M = 0.06, 0.08

DRAWN: dict[str, tuple[float, float]] = {
    "thickness_m": (1e-4, 0.03), "substep_s": (2e-4, 0.02), "area_density": (1e-3, 10.0),
    "damping": (1e-3, 1e3), "sleep_speed": (1e-4, 1.0), "speed_limit": (0.05, 100.0),
    "rebuild_s": (1e-3, 1.0), "contact_margin_m": (1e-4, 0.03), "push_out_speed": (1e-2, 30.0),
    "bend_limit": (1e-2, 1.0), "buckling": (1.0, 1e4),
}  # fmt: skip
"""From where numbers of the solver are drawn, evenly in their logarithm; a tenth of them is 0 where
0 is permitted."""

MAY_BE_NOTHING = ("damping", "sleep_speed", "contact_margin_m", "push_out_speed", "bend_limit")

MATERIAL: dict[str, tuple[float, float]] = {
    "stretch_compliance": (1e-8, 1e3), "bend_compliance": (1e-6, 1e4),
    "table_friction": (1e-3, 1e2), "particle_friction": (1e-3, 1e2),
}  # fmt: skip

GAIN = 1.0
"""A free cloth may turn into motion and height what its threads have stored when it is let go, and
besides as much as it takes to carry all of it as far as the picker went."""


def case(number: int, seed: int, stage: Path, box: Path) -> dict:
    """Pick, drag and drop with the settings of one case; a row with what became of it."""
    del stage
    return child_result(lambda: rolled_out(*drawn(np.random.default_rng([seed, number]))), box)


def drawn(rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, float]]:
    """Return settings of the solver and of the material."""

    def value(limits: tuple[float, float], *, nothing: bool) -> float:
        number = float(np.exp(rng.uniform(*np.log(limits))))
        return 0.0 if nothing and rng.random() < 0.1 else number

    config: dict[str, Any] = {
        name: value(limits, nothing=name in MAY_BE_NOTHING) for name, limits in DRAWN.items()
    }
    # Whether layers touch was drawn once: cases keep their numbers.
    rng.choice(["vertex-triangle", "none"])
    config["edge_contact"] = bool(rng.random() < 0.5)
    config["contact_depth_m"] = config["thickness_m"] * float(rng.uniform(1.0, 5.0))
    tilt = rng.normal(0.0, 2.0, 2) if rng.random() < 0.3 else (0.0, 0.0)
    config["gravity"] = (float(tilt[0]), float(tilt[1]), -float(rng.uniform(0.0, 30.0)))
    return config, {name: value(limits, nothing=True) for name, limits in MATERIAL.items()}


def rolled_out(config: dict[str, Any], material: dict[str, float]) -> dict:
    """Lift, drag and drop a towel of 36 vertices; the worst of what must hold."""
    from clothtrack.garments import towel
    from clothtrack.recordings import Table
    from clothtrack.simulation import (
        ClothDynamics,
        ClothParameters,
        ClothSolver,
        HeldMotion,
        SolverConfig,
    )

    flat = towel(0.1, 0.1, 0.02)
    floor = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    settings = SolverConfig(table=floor, **config)
    height = settings.resting_height_m
    mesh = flat.with_vertices(flat.vertices + (0.0, 0.0, height - flat.vertices[:, 2].min()))
    solver = ClothSolver(mesh, settings, parameters=ClothParameters(**material))
    start = mesh.vertices[:1]
    lifted, dragged = start + (0.0, 0.0, LIFT_M), start + (DRAG_M, 0.0, LIFT_M)
    dynamics, lowest, finite = ClothDynamics(solver), height, True
    for way in ((start, lifted), (lifted, dragged)):
        motion = HeldMotion(np.array([0]), np.stack(way))
        moved = dynamics.roll_out(None, motion, MOVED_S)
        lowest = min(lowest, float(moved.positions[..., 2].min()))
    energies, threads = [energy(solver)], stored(solver)
    for _ in range(round(FREE_S / SAMPLE_S)):
        solver.step(SAMPLE_S)
        energies.append(energy(solver))
        lowest = min(lowest, float(solver.positions[..., 2].min()))
        finite = finite and bool(np.isfinite(solver.positions).all())
    finite = finite and bool(np.isfinite(energies).all()) and math.isfinite(lowest)
    # What it takes to carry the whole cloth as far as the picker goes.
    weight = float((mesh.vertex_areas * settings.area_density).sum())
    work = weight * (LIFT_M + DRAG_M) * (np.linalg.norm(settings.gravity) + 1.0)
    gained = (max(energies[1:]) - energies[0]) / (work + threads) if finite else math.inf
    return {
        "finite": finite,
        "gained": float(gained) if finite else None,
        "depth_over_thickness": -lowest / settings.thickness_m if finite else None,
        "config": config,
        "material": material,
    }


def energy(solver: Any) -> float:
    """Return the energy of motion and of height [J] of the only environment."""
    masses = solver.mesh.vertex_areas * solver.config.area_density
    positions = solver.positions[0].astype(np.float64)
    velocities = solver.velocities[0].astype(np.float64)
    moving = 0.5 * masses @ (velocities**2).sum(axis=1)
    return float(moving - masses @ positions @ np.asarray(solver.config.gravity))


def stored(solver: Any) -> float:
    """Return the most energy [J] that the threads of the only environment can turn into motion.

    A thread that is x too long stores x^2 / 2 over its compliance. A thread that gives less than
    its ends move in a step (h^2 over their mass) is let go by what one step can: XPBD moves its
    ends by x / (1 + compliance / (h^2 w)).
    """
    from clothtrack.simulation.constraints import bend_constraints, stretch_constraints
    from clothtrack.simulation.parameters import ELASTIC_SUBSTEPS

    mesh, config, material = solver.mesh, solver.config, solver.parameters[0]
    positions = solver.positions[0].astype(np.float64)
    lightness = 1.0 / (mesh.vertex_areas * config.area_density)
    step_s = config.substep_s / ELASTIC_SUBSTEPS
    total = 0.0
    for constraints, compliance in (
        (stretch_constraints(mesh), material.stretch_compliance),
        (bend_constraints(mesh), material.bend_compliance),
    ):
        ends = positions[constraints.pairs]
        stretch = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) - constraints.lengths
        give = compliance + step_s**2 * lightness[constraints.pairs].sum(axis=1)
        total += float((0.5 * stretch**2 / give).sum())
    return total


def violates(row: dict) -> bool:
    """Return whether a case shows a defect."""
    return not row["finite"] or row["gained"] > GAIN or row["depth_over_thickness"] > 1.0


def markdown(rows: list[dict]) -> str:
    """Return what held, over all cases."""
    finite = [row for row in rows if row["finite"]]
    gained = sum(row["gained"] > GAIN for row in finite)
    deep = sum(row["depth_over_thickness"] > 1.0 for row in finite)
    return (
        "| settings | not finite | energy gained | table crossed |\n|---:|---:|---:|---:|\n"
        f"| {len(rows)} | {len(rows) - len(finite)} | {gained} | {deep} |\n"
    )
