"""How states of a garment come about: the recipes, how often each is used, and their lengths."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from clothtrack.reconstruction.data.folding import NeatFold
from clothtrack.simulation.pick_and_place import ActionConfig

Recipe = Literal[NeatFold, "flat", "drop", "lift", "held", "push", "pick_and_place", "release"]


REFERENCE_SIZE_M = 0.4
"""Longer side of a garment for which lengths of `CrumplingConfig` hold as they are [m]; those of a
larger garment grow with it, and speeds with the root of it, as free fall does."""

ACTION = ActionConfig(speed=0.6, clear_held=True)
"""Pick-and-places on a garment of that size; reach and release height follow the garment."""


@dataclass(frozen=True)
class CrumplingConfig:
    """How states of a garment come about. Pairs of numbers are bounds of an even draw.

    Lengths and speeds are those for a garment of `REFERENCE_SIZE_M`.

    Attributes:
        states: states per episode.
        shares: how often an episode begins with each recipe.
        after_fold: how often each recipe follows a neat fold (`NEAT`).
        next_shares: how often each follows another; what was held in the air is let go first.
        turned_over: share of episodes that begin with the garment's other side up.
        pressed: share of episodes whose neat folds are pressed flat and stay so; others the solver
            lets go, which makes them soft.
        wrinkled: share of flat and folded states that have fine wrinkles.
        lift_m: how high a vertex is lifted when the cloth stays on the table in part [m].
        two_pickers: share of pick-and-places with a second gripper that moves alike.
        folded, middle, pulled: shares of pick-and-places that take folded cloth with all its
            layers, cloth near the middle, and the outline to carry it outwards, as one who flattens
            a crumpled cloth; the others take mostly the outline, and carry it inwards.
        rest_limit_s: longest wait until a cloth is at rest [s].
        strain_limit: a state whose edges changed length by more than this share, in the mean, has
            exploded, as has one of which a vertex lies under the table.
        folded_strain_limit: the same for pressed stacks, whose creases take up most of it.
    """

    states: int = 5
    shares: dict[str, float] = field(
        default_factory=lambda: {
            "flat": 0.08, "fold": 0.1, "fold_half": 0.2, "fold_corner": 0.14, "fold_strips": 0.1,
            "fold_sleeves": 0.14, "roll": 0.03, "drop": 0.08, "lift": 0.015, "held": 0.045,
            "push": 0.015, "pick_and_place": 0.055,
        }
    )  # fmt: skip
    after_fold: dict[str, float] = field(
        default_factory=lambda: {
            "fold": 0.08, "fold_half": 0.2, "fold_corner": 0.1, "fold_top": 0.32,
            "fold_strips": 0.02, "roll": 0.03, "turn_over": 0.08, "held": 0.03, "push": 0.03,
            "pick_and_place": 0.11,
        }
    )  # fmt: skip
    next_shares: dict[str, float] = field(
        default_factory=lambda: {"pick_and_place": 0.7, "held": 0.2, "push": 0.1}
    )
    turned_over: float = 0.5
    pressed: float = 0.75
    wrinkled: float = 0.7
    lift_m: tuple[float, float] = (0.08, 0.25)
    two_pickers: float = 0.3
    folded: float = 0.15
    middle: float = 0.15
    pulled: float = 0.35
    rest_limit_s: float = 0.8
    strain_limit: float = 0.05
    folded_strain_limit: float = 0.06


def drawn(shares: Mapping[str, float], rng: np.random.Generator) -> Recipe:
    """Draw a recipe, each as often as its share says."""
    names = [name for name in get_args(Recipe) if shares.get(name, 0.0) > 0.0]
    share = np.array([shares[name] for name in names])
    return names[int(rng.choice(len(names), p=share / share.sum()))]
