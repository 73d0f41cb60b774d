"""The simulated world of the claim: one garment outside all training data, on a realistic table.

In a third of the actions the cloth slips out of the gripper or the gripper takes the layer below
too. Stiffness and both frictions lie beyond what the benchmark draws and between the values that
calibrations try; the picker's path is 3 mm off.
"""

from dataclasses import replace
from pathlib import Path

from clothtrack.errors import InvalidConfigError
from clothtrack_lab.world import SMALL_WORLD, EpisodeConfig, simulate
from clothtrack_lab.world.one_garment import OneGarment
from shared.bench_runs import Trajectory, trajectories

GARMENTS = {
    "tshirt": OneGarment("tshirt", 1),
    "sweater": OneGarment("tshirt", 1, sweater=True),
    "towel": OneGarment("towel", 1),
}

SLIPS = BOTH_LAYERS = 1.0 / 6.0
PATH_ERROR_M = 0.003
"""Root mean square length of the constant error of the picker's path [m]."""

VERTICES = 800
"""Of the world's cloth and of the first mesh; their triangulations differ."""

YOUNG_PA = 9e4
TABLE_FRICTION = 0.25
CLOTH_FRICTION = 0.85

LEARNED_SEED, HELD_OUT_SEED = 0, 9000
"""Of the first recording; more to learn from changes nothing of what is held out."""


def unkind(garment: OneGarment) -> EpisodeConfig:
    """Return how a garment is filmed."""
    usual = garment.config
    if usual.fabric is None or usual.template is None:
        raise InvalidConfigError(f"{garment.label} has no fabric or no first mesh; give both")
    fabric = replace(
        usual.fabric,
        young_pa=YOUNG_PA,
        table_friction=TABLE_FRICTION,
        cloth_friction=CLOTH_FRICTION,
    )
    return replace(
        usual,
        vertex_count=VERTICES,
        template=replace(usual.template, vertex_count=VERTICES),
        slips=SLIPS,
        picker_bias_m=PATH_ERROR_M / 3.0**0.5,
        fabric=fabric,
        action=replace(usual.action, both_layers=BOTH_LAYERS),
    )


def film(
    folder: Path, garment: OneGarment, count: int, seed: int, *, smoke: bool = False
) -> list[Trajectory]:
    """Return recordings of a garment, filmed where they are missing.

    Args:
        folder: for `recordings/` and `truth/`.
        garment: which.
        count: how many.
        seed: of the first one.
        smoke: a napkin of one action in place of the garment.
    """
    if smoke:
        simulate(folder, garment.kind, count, seed=seed, config=SMALL_WORLD)
    else:
        simulate(folder, garment.kind, count, seed=seed, config=unkind(garment), garment=garment)
    return sorted(trajectories(folder), key=lambda one: one.name)[:count]
