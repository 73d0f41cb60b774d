"""A single garment for many recordings and episodes, outside the networks' training data.

The paper fine-tunes for a garment that the network has never seen. All constant properties of such
a garment are drawn here from one seed: cut, size, fabric, its mesh in the world, and the camera,
tool and speeds of its table. Poses, starts, actions, colors and noise are drawn from the seed of
the recording or the episode, as usual.

Sizes fit the published network's canonical cube but are outside its training range. Cuts are
outside the range of `garments.outlines.draw_shirt`, the cloth is thicker than any in the benchmark,
and the camera is noisier.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import DEFAULT_SIZES_M, GarmentKind, garment, shirt
from clothtrack.garments.outlines import ShirtOutline
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.template_file import write_template
from clothtrack_lab.world.bench import Ranges, vary
from clothtrack_lab.world.episodes import EpisodeConfig
from clothtrack_lab.world.template_mesh import size_of

_SHIRT_WIDTHS_M = (0.56, 0.59)
"""Width of a shirt from sleeve to sleeve [m]; the published network was trained on 0.42 to 0.54."""

_TOWEL_LENGTHS_M = (0.36, 0.39)
"""Longer side of a towel [m]; the published network was trained on 0.22 to 0.34."""

TOWEL_ASPECTS = (0.4, 0.48)
"""Shorter side over the longer one; states of towels have 0.5 to 1."""

_OF_GARMENTS = 0x0E6A
"""Constant that separates this module's random draws from those of others with the same seed."""


@dataclass(frozen=True)
class OneGarment:
    """A garment, and the table that it is recorded on.

    Attributes:
        sweater: whether a shirt has the long sleeves and the wide armholes of a sweater.
    """

    kind: GarmentKind
    seed: int
    sweater: bool = False

    def __post_init__(self) -> None:
        """Refuse invalid settings."""
        if self.seed < 0:
            raise InvalidConfigError(f"garment_seed is {self.seed}; give 0 or more")
        if self.sweater and self.kind != "tshirt":
            raise InvalidConfigError(f"a sweater is a tshirt, and kind is {self.kind!r}")

    @property
    def label(self) -> str:
        """Prefix of the names of its recordings and episodes."""
        return f"{self.kind}_{'s' if self.sweater else 'g'}{self.seed:04d}"

    @cached_property
    def cut(self) -> tuple[ShirtOutline | None, tuple[float, float]]:
        """Outline of a shirt, None for a towel; width and length [m]."""
        rng = np.random.default_rng([_OF_GARMENTS, self.seed, _number(self.kind)])
        if self.kind == "towel":
            length_m = float(rng.uniform(*_TOWEL_LENGTHS_M))
            return None, (length_m, length_m * float(rng.uniform(*TOWEL_ASPECTS)))
        outline = _drawn(rng, _SWEATER if self.sweater else _TSHIRT)
        widest = float(np.ptp(_corners(outline)[:, 0]))
        return outline, (width_m := float(rng.uniform(*_SHIRT_WIDTHS_M)), width_m / widest)

    def flat(self, *, vertex_count: int = 1000, again: bool = False) -> ClothMesh:
        """Return the garment at rest, around the origin."""
        outline, size_m = self.cut
        seed = 2 * self.seed + again
        if outline is None:
            return garment(
                self.kind, vertex_count=vertex_count, size_m=size_m, seed=seed,
                pattern="alternating" if again else "random",
            )  # fmt: skip
        return shirt(outline, size_m[1], vertex_count=vertex_count, seed=seed)

    @cached_property
    def config(self) -> EpisodeConfig:
        """Episode configuration with fabric, camera, tool and speeds."""
        width_m, length_m = size_of(self.flat())
        longest = max(width_m, length_m)
        # The camera's height depends on the longer side.
        ranges = replace(
            _OUTSIDE,
            towel_side_m=(longest, longest),
            tshirt_width_m=(width_m, width_m),
            tshirt_length_m=(length_m, length_m),
        )
        return replace(vary(self.kind, self.seed, ranges), size_m=(width_m, length_m))

    def write_template(self, folder: Path) -> Path:
        """Write the garment's template as `clothtrack garment` makes it from a flat garment."""
        path = folder / f"{self.label}.npz"
        if not path.exists():
            write_template(self.flat(again=True), path)
        return path


_OUTSIDE = Ranges(
    thickness_m=(0.75e-3, 0.85e-3),
    area_density=(0.32, 0.38),
    contact_radius_m=(2.0e-3, 2.3e-3),
    focal=(500.0, 550.0),
    white_m=(1.6e-3, 2.0e-3),
    wave_m=(1.0e-3, 1.2e-3),
)


_TSHIRT = {
    "body": (0.97, 1.05), "waist": (1.12, 1.18), "shoulder": (0.84, 0.92), "slope": (0.1, 0.13),
    "armhole": (0.37, 0.41), "sleeve": (0.24, 0.32), "sleeve_angle_rad": (0.2, 0.5),
    "cuff": (0.29, 0.32), "neck": (0.17, 0.2), "front_depth": (0.15, 0.19),
    "back_depth": (0.045, 0.07),
}  # fmt: skip
"""A wide, boxy shirt that flares to its hem, with a large neck and wide sleeves."""

_SWEATER = {
    "body": (1.06, 1.12), "waist": (0.66, 0.71), "shoulder": (0.84, 0.92), "slope": (0.13, 0.15),
    "armhole": (0.43, 0.46), "sleeve": (0.7, 0.85), "sleeve_angle_rad": (0.95, 1.1),
    "cuff": (0.21, 0.24), "neck": (0.175, 0.19), "front_depth": (0.05, 0.08),
    "back_depth": (0.035, 0.05),
}  # fmt: skip
"""A wide sweater, gathered at its hem, with low armholes and wide cuffs."""


def _drawn(rng: np.random.Generator, ranges: Mapping[str, tuple[float, float]]) -> ShirtOutline:
    """Return random proportions from these ranges whose outline does not cross itself."""
    while True:
        outline = ShirtOutline(**{name: rng.uniform(*ends) for name, ends in ranges.items()})
        try:
            _corners(outline)
        except InvalidConfigError:
            continue
        return outline


def _corners(outline: ShirtOutline) -> np.ndarray:
    """Return the corners of a shirt of length 1 [m]."""
    return np.concatenate([one.points for one in outline.spans(1.0, depth=outline.front_depth)])


def _number(kind: GarmentKind) -> int:
    return list(DEFAULT_SIZES_M).index(kind)
