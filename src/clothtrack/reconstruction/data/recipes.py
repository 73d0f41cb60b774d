"""The recipes that make states of a garment, with their frequencies and lengths."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from clothtrack.reconstruction.data.folding import NeatFold
from clothtrack.simulation.pick_and_place import ActionConfig

Recipe = Literal[NeatFold, "flat", "drop", "lift", "held", "push", "pick_and_place", "release"]


REFERENCE_SIZE_M = 0.4
"""Longer side of a garment for which the lengths of `CrumplingConfig` hold unscaled [m]. Lengths
scale with the garment, and speeds with the root of its size, as in free fall."""

ACTION = ActionConfig(speed=0.6, clear_held=True)
"""Pick-and-place settings for a garment of that size; reach and release height depend on the
garment."""


@dataclass(frozen=True)
class CrumplingConfig:
    """Settings of the recipes. Pairs of numbers are bounds of a uniform draw.

    Lengths and speeds are those for a garment of `REFERENCE_SIZE_M`.

    Attributes:
        states: number of states per episode.
        shares: relative frequency of each recipe at the start of an episode.
        after_fold: relative frequency of each recipe after a neat fold (`NEAT`).
        next_shares: relative frequency of each recipe after others; held cloth is let go first.
        turned_over: share of episodes that begin with the garment's other side up.
        pressed: share of episodes whose neat folds are pressed flat and stay so; in others the
            solver lets the cloth relax, which makes folds soft.
        wrinkled: share of flat and folded states with fine wrinkles.
        lift_m: height that a vertex is lifted to while part of the cloth stays on the table [m].
        two_pickers: share of pick-and-places with a second gripper that moves alike.
        folded, middle, pulled: shares of pick-and-places that grasp folded cloth with all its
            layers, cloth near the middle, and the outline to carry it outwards, as in flattening a
            crumpled cloth; the others grasp mostly the outline and carry it inwards.
        rest_limit_s: longest wait until a cloth is at rest [s].
        strain_limit: mean relative change of edge length above which a state has exploded; it has
            also exploded if a vertex lies under the table.
        folded_strain_limit: the same for pressed stacks, whose strain is mostly in the creases.
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
    """Draw a recipe with probability proportional to its share."""
    names = [name for name in get_args(Recipe) if shares.get(name, 0.0) > 0.0]
    share = np.array([shares[name] for name in names])
    return names[int(rng.choice(len(names), p=share / share.sum()))]
