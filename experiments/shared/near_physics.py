"""Physics around the default: each number of the solver within three times or a third of its own.

Practical settings are in this range. The three conditions of `random_physics` are checked on the
same cloth with the same pick, drag and drop. Only the speed limit is off, because it would hide an
energy gain.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from shared.random_physics import markdown, rolled_out, violates
from shared.trial import child_result

__all__ = ["case", "drawn", "markdown", "violates"]

FACTOR = 3.0
"""From a number's third to three times the number, evenly in its logarithm."""

VARIED = (
    "thickness_m", "substep_s", "area_density", "damping", "sleep_speed", "rebuild_s",
    "contact_margin_m", "push_out_speed",
)  # fmt: skip

MATERIAL = ("bend_compliance", "table_friction", "particle_friction")

SOFTEST, STIFFEST = 0.1, 1e-4
"""Half of the clothes stretch, by a compliance between these [m/N]; the default does not."""

NO_LIMIT = 100.0
"""Speed limit [m/s] that nothing here comes near."""


def case(number: int, seed: int, stage: Path, box: Path) -> dict:
    """Pick, drag and drop with the settings of one case; a row with what became of it."""
    del stage
    return child_result(lambda: rolled_out(*drawn(np.random.default_rng([seed, number]))), box)


def drawn(rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, float]]:
    """Return settings of the solver and of the material, near their defaults."""
    from clothtrack.simulation import ClothParameters, SolverConfig

    def near(usual: float) -> float:
        return usual * float(np.exp(rng.uniform(-1.0, 1.0) * math.log(FACTOR)))

    solver, cloth = SolverConfig(), ClothParameters()
    config: dict[str, Any] = {name: near(getattr(solver, name)) for name in VARIED}
    # Whether layers touch was drawn once: cases keep their numbers.
    rng.choice(["vertex-triangle", "none"])
    config["edge_contact"] = bool(rng.random() < 0.5)
    config["contact_depth_m"] = max(config["thickness_m"], near(solver.contact_depth_m))
    config["speed_limit"] = NO_LIMIT
    material = {name: near(getattr(cloth, name)) for name in MATERIAL}
    softness = float(np.exp(rng.uniform(math.log(STIFFEST), math.log(SOFTEST))))
    material["stretch_compliance"] = softness if rng.random() < 0.5 else 0.0
    return config, material
