"""Random draws of garments: size, cut and cloth."""

from dataclasses import dataclass
from typing import Annotated, get_args

import numpy as np

from clothtrack.files.bounds import Checked, Interval, Share
from clothtrack.garments.garment_meshes import ClothKind, garment, shirt, trousers
from clothtrack.garments.outlines import (
    draw_robe,
    draw_shirt,
    draw_sweater,
    draw_trousers,
    with_hood,
)
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.parameters import ClothParameters

BEND_LENGTH_M = 0.016
"""Edge length [m] that a bend compliance is drawn for. The compliance of the same cloth grows with
the square of the edge length."""

KINDS: tuple[str, ...] = get_args(ClothKind)

_Lengths = Annotated[tuple[float, float], Interval(least=0, empty=True)]


@dataclass(frozen=True)
class GarmentRanges(Checked):
    """Sizes and cuts of garments, as bounds of a uniform draw.

    Attributes:
        towel_side_m: longer side of a towel or a blanket [m], log-uniform.
        shirt_length_m: length from the hem to the neck [m], log-uniform.
        long_sleeves: share of shirts with long sleeves (`garments.outlines.draw_shirt`).
        sweaters, robes: shares of shirts that are cut as a sweater, and as a robe.
        robe_length_m: length of a robe from the hem to the neck [m], log-uniform.
        trousers_length_m, shorts_length_m: length from the waist to the cuffs [m], log-uniform.
    """

    towel_side_m: _Lengths = (0.2, 2.0)
    towel_aspect: Annotated[tuple[float, float], Interval(least=0, most=1, empty=True)] = (0.5, 1.0)
    square: Share = 0.3
    shirt_length_m: _Lengths = (0.3, 0.85)
    long_sleeves: Share = 0.35
    sweaters: Share = 0.22
    robes: Share = 0.1
    hoods: Share = 0.4
    robe_length_m: _Lengths = (0.75, 1.35)
    open_shirts: Share = 0.12
    open_sweaters: Share = 0.35
    open_robes: Share = 0.8
    trousers_length_m: _Lengths = (0.4, 1.15)
    shorts_length_m: _Lengths = (0.25, 0.6)
    shorts: Share = 0.35


@dataclass(frozen=True)
class ClothRanges:
    """Materials of garments, as bounds of a uniform draw.

    Attributes:
        thickness_m: distance of the layers of a pressed stack [m], log-uniform.
        contact_m: least distance that layers keep in the solver [m] for a garment of
            `REFERENCE_SIZE_M`; it grows with the root of the size. It is a little more than that of
            the benchmark's cloth, which halves the crossings.
        area_density: mass per area [kg/m^2].
        bend_compliance: inverse stiffness between vertices that face each other across an edge of
            `BEND_LENGTH_M` [m/N], log-uniform.
        stretch_compliance: inverse stiffness of an edge [m/N], log-uniform. At 0 a sheet of 16 mm
            edges is too stiff to wrinkle, and a dropped T-shirt may spring out flat.
    """

    thickness_m: tuple[float, float] = (0.0005, 0.008)
    contact_m: tuple[float, float] = (0.0035, 0.0042)
    area_density: tuple[float, float] = (0.12, 0.3)
    bend_compliance: tuple[float, float] = (3.0, 100.0)
    stretch_compliance: tuple[float, float] = (1e-3, 8e-3)
    table_friction: tuple[float, float] = (0.3, 0.9)
    particle_friction: tuple[float, float] = (0.25, 0.75)


def draw_garment(
    kind: ClothKind, ranges: GarmentRanges, vertex_count: int, rng: np.random.Generator
) -> ClothMesh:
    """Draw a flat garment of any size; a towel's width is its longer side."""
    if kind == "towel":
        return _towel(ranges, vertex_count, rng)
    if kind == "trousers":
        short = rng.random() < ranges.shorts
        bounds = ranges.shorts_length_m if short else ranges.trousers_length_m
        length_m = _log_even(bounds, rng)
        legs = draw_trousers(rng, short=float(short))
        return trousers(legs, length_m, vertex_count=vertex_count, seed=_seed(rng))
    cut = rng.random()
    if cut < ranges.robes:
        length_m, outline = _log_even(ranges.robe_length_m, rng), draw_robe(rng)
        open_front = rng.random() < ranges.open_robes
    elif cut < ranges.robes + ranges.sweaters:
        length_m, outline = _log_even(ranges.shirt_length_m, rng), draw_sweater(rng)
        if rng.random() < ranges.hoods:
            outline = with_hood(outline, rng)
        open_front = rng.random() < ranges.open_sweaters
    else:
        length_m = _log_even(ranges.shirt_length_m, rng)
        outline = draw_shirt(rng, long_sleeves=ranges.long_sleeves)
        open_front = rng.random() < ranges.open_shirts
    return shirt(
        outline, length_m, vertex_count=vertex_count, open_front=open_front, seed=_seed(rng)
    )


def _towel(ranges: GarmentRanges, vertex_count: int, rng: np.random.Generator) -> ClothMesh:
    """Draw a rectangle with its longer side along x."""
    length_m = _log_even(ranges.towel_side_m, rng)
    square = rng.random() < ranges.square
    aspect = 1.0 if square else float(rng.uniform(*ranges.towel_aspect))
    return garment(
        "towel",
        vertex_count=vertex_count,
        size_m=(length_m, aspect * length_m),
        pattern="random",
        seed=_seed(rng),
    )


def _log_even(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    """Draw a log-uniform number between two bounds."""
    return float(np.exp(rng.uniform(*np.log(bounds))))


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(1 << 31))


def draw_parameters(ranges: ClothRanges, rng: np.random.Generator) -> ClothParameters:
    """Draw the material of one cloth from the ranges."""
    bend = _log_even(ranges.bend_compliance, rng)
    stretch = _log_even(ranges.stretch_compliance, rng)
    return ClothParameters(
        stretch_compliance=stretch,
        bend_compliance=bend,
        table_friction=float(rng.uniform(*ranges.table_friction)),
        particle_friction=float(rng.uniform(*ranges.particle_friction)),
    )
