"""What garments states are made of: how large, how cut, of what cloth."""

from dataclasses import dataclass

import numpy as np

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.garments import GarmentKind, garment, shirt
from clothtrack.simulation.outlines import draw_shirt
from clothtrack.simulation.parameters import ClothParameters

BEND_LENGTH_M = 0.016
"""Length of an edge [m] for which a bend compliance is drawn. Between vertices that are farther
apart the same cloth gives more, by the square of their distance."""


@dataclass(frozen=True)
class GarmentRanges:
    """How large garments are, and how they are cut: bounds of an even draw.

    Attributes:
        towel_side_m: longer side of a towel [m]; its logarithm is drawn evenly.
        towel_aspect: shorter side over the longer one.
        square: share of towels whose sides are equal.
        shirt_length_m: from the hem to the neck [m]; its logarithm is drawn evenly.
        long_sleeves: share of shirts with long sleeves (`simulation.outlines.draw_shirt`).
    """

    towel_side_m: tuple[float, float] = (0.2, 1.5)
    towel_aspect: tuple[float, float] = (0.5, 1.0)
    square: float = 0.3
    shirt_length_m: tuple[float, float] = (0.3, 0.85)
    long_sleeves: float = 0.35


@dataclass(frozen=True)
class ClothRanges:
    """What garments are made of: bounds of an even draw.

    Attributes:
        thickness_m: distance of the layers of a pressed stack [m]; its logarithm is drawn evenly.
        contact_m: least distance that layers keep in the solver [m] in a garment of
            `REFERENCE_SIZE_M`; it grows with the root of the size. A little more than the
            benchmark's cloth, which halves the crossings.
        area_density: mass per area [kg/m^2].
        bend_compliance: inverse stiffness between vertices that face each other across an edge of
            `BEND_LENGTH_M` [m/N]; its logarithm is drawn evenly.
        stretch_compliance: inverse stiffness of an edge [m/N]; its logarithm is drawn evenly. At 0
            a sheet of 16 mm edges is too stiff to wrinkle: a dropped T-shirt may spring out flat.
        table_friction: Coulomb coefficient between cloth and table.
        particle_friction: Coulomb coefficient between cloth and cloth.
    """

    thickness_m: tuple[float, float] = (0.0005, 0.008)
    contact_m: tuple[float, float] = (0.0035, 0.0042)
    area_density: tuple[float, float] = (0.12, 0.3)
    bend_compliance: tuple[float, float] = (3.0, 100.0)
    stretch_compliance: tuple[float, float] = (1e-3, 8e-3)
    table_friction: tuple[float, float] = (0.3, 0.9)
    particle_friction: tuple[float, float] = (0.25, 0.75)


def draw_garment(
    kind: GarmentKind, ranges: GarmentRanges, vertex_count: int, rng: np.random.Generator
) -> ClothMesh:
    """A flat garment of any size; a towel's width is its longer side.

    Args:
        kind: "towel", or "tshirt" for shirts with sleeves of any length.
        ranges: of sizes and cuts.
        vertex_count: about how many vertices it has.
        rng: of its size, outline and triangulation.
    """
    towel = kind == "towel"
    bounds = ranges.towel_side_m if towel else ranges.shirt_length_m
    length_m = float(np.exp(rng.uniform(*np.log(bounds))))
    if towel:
        square = rng.random() < ranges.square
        aspect = 1.0 if square else float(rng.uniform(*ranges.towel_aspect))
        return garment(
            "towel",
            vertex_count=vertex_count,
            size_m=(length_m, aspect * length_m),
            pattern="random",
            seed=int(rng.integers(1 << 31)),
        )
    outline = draw_shirt(rng, long_sleeves=ranges.long_sleeves)
    return shirt(outline, length_m, vertex_count=vertex_count, seed=int(rng.integers(1 << 31)))


def draw_parameters(ranges: ClothRanges, rng: np.random.Generator) -> ClothParameters:
    """What one cloth is made of, drawn from the ranges."""
    bend, stretch = (
        float(np.exp(rng.uniform(*np.log(bounds))))
        for bounds in (ranges.bend_compliance, ranges.stretch_compliance)
    )
    return ClothParameters(
        stretch_compliance=stretch,
        bend_compliance=bend,
        table_friction=float(rng.uniform(*ranges.table_friction)),
        particle_friction=float(rng.uniform(*ranges.particle_friction)),
    )
