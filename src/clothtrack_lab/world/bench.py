"""The benchmark `clothtrack-bench`: its trajectories and their variation.

It has 50 trajectories of three pick-and-places, 25 towels and 25 two-layer T-shirts, in two splits:
`dev` for tuning, and `test` only for scoring. There are ten `hard` ones besides. All variation is
drawn from the trajectory's seed alone, from the intervals in `Ranges`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np

from clothtrack.garments.garment_meshes import (
    DEFAULT_SIZES_M,
    TOWEL_SIDES_M,
    TSHIRT_LENGTHS_M,
    TSHIRT_WIDTHS_M,
    GarmentKind,
)
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.simulation.pick_and_place import ActionConfig
from clothtrack_lab.world.episodes import EpisodeConfig
from clothtrack_lab.world.flex import Fabric
from clothtrack_lab.world.tool import RADII_M, Tool

Split = Literal["dev", "test", "hard"]
Hardness = Literal["none", "middle", "folded", "hidden", "calibration", "missing"]
SPLITS: tuple[Split, ...] = get_args(Split)

COUNTS: Mapping[Split, int] = MappingProxyType({"dev": 10, "test": 15})
"""Number of trajectories per kind of garment."""

_FIRST_SEEDS: Mapping[Split, int] = MappingProxyType({"dev": 1000, "test": 2000, "hard": 3000})
_SPARE_SEEDS = 5
"""Number of retries of a trajectory whose physics diverges, each with the next seed."""

_SEEDS_APART = _SPARE_SEEDS + 1
"""Distance between the first seeds of two trajectories, so that they share no spare seeds."""

_RELEASE_GAP_M = 0.002
"""Gap under the carried layers when the gripper opens [m]."""

_OF_BENCH = 0xBE7C
"""Constant that separates this module's random draws from those of the episode with the same
seed."""


@dataclass(frozen=True)
class Ranges:
    """The bounds of a trajectory's values, which are drawn uniformly between them.

    Attributes:
        towel_side_m: width and, independently, length of a towel [m].
        tshirt_width_m: width of a T-shirt from sleeve to sleeve [m].
        tshirt_length_m: length of a T-shirt [m].
        young_pa: Young's modulus [Pa].
        thickness_m: thickness of the elastic shell [m]; with `young_pa` it determines the bending
            stiffness, 0.1 to 1.7 micronewton meters.
        area_density: mass per area [kg/m^2].
        contact_radius_m: half the distance between layers [m], which is half the cloth's thickness.
        distance_over_size: distance of the camera from the table [m] minus 0.3 m, over the longer
            side of the garment [m].
        tilt_deg: standard deviation of the camera's tilt about x, about y and of its roll [deg].
        focal: focal length [pixels] at a width of 640 pixels.
        white_m: standard deviation of independent depth noise [m] at 0.75 m.
        wave_m: standard deviation of slowly varying depth error [m].
        dropout: share of pixels without depth on surfaces seen from the front.
        edge_dropout: share of silhouette pixels without depth.
        edge_mixing: share of the other silhouette pixels that mix both depths.
        patch_dropout: share of the picture without depth in connected patches.
        picker_error_m: standard deviation, per axis, of the constant error of the tip, and of its
            error per sample [m].
        speed: highest speed of the tip with cloth [m/s].
        tool_azimuth_rad: direction from which the tool comes, seen from above; 0 is the far side
            [rad].
        tool_elevation_deg: elevation of the tool above the table [deg].
        tool_size: thickness of the tool over that of the usual one.
    """

    towel_side_m: tuple[float, float] = TOWEL_SIDES_M
    tshirt_width_m: tuple[float, float] = TSHIRT_WIDTHS_M
    tshirt_length_m: tuple[float, float] = TSHIRT_LENGTHS_M
    young_pa: tuple[float, float] = (2.5e4, 6e4)
    poisson: tuple[float, float] = (0.1, 0.3)
    thickness_m: tuple[float, float] = (0.4e-3, 0.68e-3)
    area_density: tuple[float, float] = (0.12, 0.3)
    contact_radius_m: tuple[float, float] = (1.1e-3, 1.9e-3)
    table_friction: tuple[float, float] = (0.3, 0.9)
    cloth_friction: tuple[float, float] = (0.25, 0.75)
    distance_over_size: tuple[float, float] = (1.0, 1.5)
    tilt_deg: tuple[float, float] = (0.5, 6.0)
    focal: tuple[float, float] = (570.0, 630.0)
    white_m: tuple[float, float] = (0.5e-3, 1.4e-3)
    wave_m: tuple[float, float] = (0.2e-3, 0.9e-3)
    dropout: tuple[float, float] = (0.0, 0.05)
    grazing_dropout: tuple[float, float] = (0.3, 0.8)
    edge_dropout: tuple[float, float] = (0.2, 0.5)
    edge_mixing: tuple[float, float] = (0.3, 0.6)
    patch_dropout: tuple[float, float] = (0.0, 0.03)
    picker_error_m: tuple[float, float] = (0.3e-3, 1.2e-3)
    speed: tuple[float, float] = (0.2, 0.3)
    tool_azimuth_rad: tuple[float, float] = (-0.7, 0.7)
    tool_elevation_deg: tuple[float, float] = (28.0, 45.0)
    tool_size: tuple[float, float] = (0.8, 2.0)


@dataclass(frozen=True)
class BenchTrajectory:
    """One trajectory of the benchmark.

    Attributes:
        changes: replaced fields of the drawn configuration; none in the benchmark except `printed`
            in its printed variant.
    """

    name: str
    kind: GarmentKind
    split: Split
    seed: int
    hardness: Hardness = "none"
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def seeds(self) -> range:
        """Seeds that are tried in turn until the physics does not diverge."""
        return range(self.seed, self.seed + _SEEDS_APART)

    def config(self, seed: int) -> EpisodeConfig:
        """Return the episode configuration with this seed."""
        return replace(hardened(vary(self.kind, seed), self.hardness), **self.changes)


def trajectories(
    splits: tuple[Split, ...] = SPLITS, *, printed: bool = False
) -> list[BenchTrajectory]:
    """Return the trajectories of some splits, in their order."""
    changes = {"printed": True} if printed else {}
    return [replace(one, changes=changes) for one in _all() if one.split in splits]


def _all() -> Iterator[BenchTrajectory]:
    kinds: tuple[GarmentKind, ...] = get_args(GarmentKind)
    for split, count in COUNTS.items():
        for kind in kinds:
            for number in range(count):
                seed = _FIRST_SEEDS[split] + _SEEDS_APART * number
                yield BenchTrajectory(f"{kind}_{split}_{number:02d}", kind, split, seed)
    for number, hardness in enumerate(get_args(Hardness)[1:]):
        for kind in kinds:
            seed = _FIRST_SEEDS["hard"] + _SEEDS_APART * number
            yield BenchTrajectory(f"{kind}_hard_{hardness}", kind, "hard", seed, hardness)


def vary(kind: GarmentKind, seed: int, ranges: Ranges | None = None) -> EpisodeConfig:
    """Return an episode configuration with every value drawn from its range.

    Colors, the pose of the garment, the actions and the direction of the camera's tilt are drawn
    from the same seed during recording.
    """
    ranges = ranges or Ranges()
    rng = np.random.default_rng([_OF_BENCH, seed, list(DEFAULT_SIZES_M).index(kind)])

    def draw(name: str) -> float:
        return float(rng.uniform(*getattr(ranges, name)))

    sides = ("towel_side_m",) * 2 if kind == "towel" else ("tshirt_width_m", "tshirt_length_m")
    size = draw(sides[0]), draw(sides[1])
    fabric = Fabric(
        young_pa=draw("young_pa"),
        poisson=draw("poisson"),
        thickness_m=draw("thickness_m"),
        area_density=draw("area_density"),
        table_friction=draw("table_friction"),
        cloth_friction=draw("cloth_friction"),
        contact_radius_m=draw("contact_radius_m"),
    )
    sensor = SensorConfig(
        focal=draw("focal"),
        camera_height_m=0.3 + draw("distance_over_size") * max(size),
        tilt_deg=draw("tilt_deg"),
        white_m=draw("white_m"),
        wave_m=draw("wave_m"),
        step_m=float(rng.choice([0.0005, 0.001])),
        dropout=draw("dropout"),
        grazing_dropout=draw("grazing_dropout"),
        edge_dropout=draw("edge_dropout"),
        edge_mixing=draw("edge_mixing"),
        patch_dropout=draw("patch_dropout"),
    )
    # Carried cloth hangs doubled under the tip, so release it at a height with room for all layers.
    layers = 2 if kind == "towel" else 4
    room = _RELEASE_GAP_M + 2.0 * layers * fabric.contact_radius_m
    thickness = draw("tool_size")
    tool = Tool(
        azimuth_rad=float(np.pi / 2.0) + draw("tool_azimuth_rad"),
        elevation_rad=float(np.radians(draw("tool_elevation_deg"))),
        radii_m=tuple((distance, thickness * radius) for distance, radius in RADII_M),
    )
    return EpisodeConfig(
        size_m=size,
        picker_bias_m=draw("picker_error_m"),
        picker_noise_m=draw("picker_error_m"),
        action=ActionConfig(
            speed=draw("speed"),
            reach_m=min(0.2, 0.65 * max(size)),
            release_height_m=room,
            clear_held=True,
        ),
        sensor=sensor,
        fabric=fabric,
        tool=tool,
    )


def hardened(config: EpisodeConfig, hardness: Hardness) -> EpisodeConfig:
    """Return the same trajectory made hard in one way.

    - `middle`: every pick is within 4 cm of the middle of the cloth as it lies.
    - `folded`: a long fold first, then picks of folded cloth with all its layers, carried inwards.
    - `hidden`: a hand and forearm that reach over the cloth to every pick; they hide about 40 %
      of it while it is moved.
    - `calibration`: the recording says that the camera is 5 mm from where it is.
    - `missing`: 20 % of the depth is missing, most of it in connected patches.
    """
    action, sensor = config.action, config.sensor
    match hardness:
        case "middle":
            return replace(config, action=replace(action, picks="middle"))
        case "folded":
            size = max(config.size_m or (0.0,))
            way = 0.35 * size, 0.5 * size
            action = replace(action, picks="folded", distance_m=way, lift_m=(0.07, 0.1))
            return replace(config, action=action)
        case "hidden":
            return replace(config, tool=_arm(max(config.size_m or (0.0,))), reach_across=True)
        case "calibration":
            return replace(config, calibration_error_m=0.005)
        case "missing":
            return replace(config, sensor=replace(sensor, dropout=0.04, patch_dropout=0.16))
        case _:
            return config


def _arm(size_m: float) -> Tool:
    """Return a hand and forearm in place of the rod, thicker for a larger garment [m]."""
    radius = 0.04 + 0.04 * size_m
    profile = ((0.0, 0.002), (0.06, 0.03), (0.2, radius), (0.9, radius + 0.02))
    return Tool(elevation_rad=float(np.radians(35.0)), radii_m=profile)
