"""The simulated camera's colors: woven cloth, a wooden table, a gray tool.

They only need to look plausible and be distinguishable by color. Depth does not depend on them.
"""

import zlib
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from clothtrack_lab.world.scene import CLOTH, TABLE, TIP, TOOL, View

CLOTH_COLORS: dict[str, tuple[int, int, int]] = {
    "blue": (38, 84, 190),
    "red": (186, 36, 40),
    "green": (28, 138, 66),
    "purple": (122, 48, 160),
}
"""Cloth colors by name (8-bit sRGB), all far from wood and from gray."""

TIP_COLORS: dict[str, tuple[int, int, int]] = {
    "pink": (232, 40, 150),
    "cyan": (20, 186, 204),
    "yellow": (240, 214, 40),
}
"""Colors of a marked tip by name (8-bit sRGB), far from wood, from gray and from every cloth."""

_WOOD_COLOR = (200, 166, 124)
_TOOL_COLOR = (118, 121, 126)
_PLANK_M = 0.12
_PRINT_PERIODS_M = 0.016, 0.05
"""Shortest and longest wavelength of a print [m], the scale of leaves and flowers, not threads."""
_PRINT_WAVES = 24
_PRINT_CONTRAST = 0.35
"""Largest change of brightness by a print, as a share of the brightness. A print has the cloth's
hue, so that the same pixels are segmented as cloth."""
_GRAIN = 3.0
"""Standard deviation of the noise in pictures of a printed cloth [gray values, 0 to 255]."""
_LIGHT = np.array([-0.45, 0.55, 0.70]) / np.linalg.norm([-0.45, 0.55, 0.70])
"""Direction from the table to the lamp."""


@dataclass(frozen=True)
class Appearance:
    """The colors of a scene.

    Attributes:
        cloth: name of the cloth's color, a key of `CLOTH_COLORS`.
        weave: strength of the woven pattern, as a share of the brightness.
        weave_period_m: period of its stripes [m].
        tip: name of the color of the tool's tip, a key of `TIP_COLORS`; gray like the rest of the
            tool when None.
        print_seed: seed of a print on the cloth, whose pictures then also have noise (`_GRAIN`);
            None for a plain cloth and noise-free pictures.
    """

    cloth: str = "blue"
    weave: float = 0.08
    weave_period_m: float = 0.024
    table_seed: int = 0
    tip: str | None = None
    print_seed: int | None = None

    @classmethod
    def sample(cls, rng: np.random.Generator) -> "Appearance":
        """Return a random appearance: one of the named colors, a weave and a table."""
        return cls(
            cloth=str(rng.choice(list(CLOTH_COLORS))),
            weave=float(rng.uniform(0.04, 0.12)),
            weave_period_m=float(rng.uniform(0.016, 0.032)),
            table_seed=int(rng.integers(1 << 31)),
        )


class Painter:
    """A painter of views of one table, whose wood is computed once."""

    def __init__(
        self, appearance: Appearance, table_points: Float[np.ndarray, "height width 3"]
    ) -> None:
        """Compute the wood color at the table point [m] of every pixel."""
        self._appearance = appearance
        wood = _wood(table_points.reshape(-1, 3), appearance.table_seed)
        self._wood = wood.reshape(table_points.shape).astype(np.float32)

    def paint(self, view: View) -> UInt8[np.ndarray, "height width 3"]:
        """Return the shaded color picture of a view, red first.

        Light is diffuse and comes from one lamp. The cloth darkens the table around it, and folds
        are darker next to higher cloth.
        """
        on_table, on_cloth = view.label == TABLE, view.label == CLOTH
        color = self._wood.copy()
        color[on_cloth] = _weave(view.material, self._appearance)
        color[view.label == TOOL] = _TOOL_COLOR
        tip = self._appearance.tip
        color[view.label == TIP] = _TOOL_COLOR if tip is None else TIP_COLORS[tip]

        # A face turned away shows the other side of the cloth, which is lit the same.
        toward = view.normals @ _LIGHT.astype(np.float32)
        toward *= np.where(view.normals[..., 2] < 0.0, -1.0, 1.0).astype(np.float32)
        light = 0.42 + 0.62 * np.clip(toward, 0.0, 1.0) / np.float32(_LIGHT[2])
        covered = cv2.GaussianBlur((~on_table).astype(np.float32), (0, 0), sigmaX=7.0)
        light[on_table] *= 1.0 - 0.35 * covered[on_table]
        around = cv2.GaussianBlur(view.height, (0, 0), sigmaX=5.0)
        sunk = np.clip(around - view.height, 0.0, 0.006)
        light[on_cloth] *= 1.0 - 60.0 * sunk[on_cloth]
        color *= light[..., None]
        color = cv2.GaussianBlur(color, (3, 3), 0.6)
        if self._appearance.print_seed is not None:
            color += _grain(view, self._appearance.print_seed)
        return np.clip(color + 0.5, 0.0, 255.0).astype(np.uint8)


def _weave(
    material: Float[np.ndarray, "pixels 3"], appearance: Appearance
) -> Float[np.ndarray, "pixels 3"]:
    """Return the unlit color (0 to 255) of the cloth, a plaid fixed to the material."""
    wave = np.cos(2.0 * np.pi * material[:, :2] / appearance.weave_period_m).sum(axis=1)
    plaid = 1.0 + 0.5 * appearance.weave * wave
    if appearance.print_seed is not None:
        plaid *= _print(material[:, :2], appearance.print_seed)
    return np.array(CLOTH_COLORS[appearance.cloth]) * plaid[:, None]


def _print(places: Float[np.ndarray, "pixels 2"], seed: int) -> Float[np.ndarray, " pixels"]:
    """Return the brightness of a print of random waves at positions on the flat cloth [m]."""
    rng = np.random.default_rng(seed)
    shortest, longest = _PRINT_PERIODS_M
    periods = shortest * (longest / shortest) ** rng.uniform(size=_PRINT_WAVES)
    angles, phases = rng.uniform(0.0, 2.0 * np.pi, (2, _PRINT_WAVES))
    turns = 2.0 * np.pi / periods * np.stack([np.cos(angles), np.sin(angles)])
    waves = np.cos(places @ turns + phases).sum(axis=1) / np.sqrt(0.5 * _PRINT_WAVES)
    # The tanh makes steep edges, as in a printed motif.
    return 1.0 + _PRINT_CONTRAST * np.tanh(2.0 * waves)


def _grain(view: View, seed: int) -> Float[np.ndarray, "height width 3"]:
    """Return the noise of one picture, seeded by the picture so that no state is kept."""
    rng = np.random.default_rng([seed, zlib.crc32(view.depth.tobytes())])
    return _GRAIN * rng.standard_normal((*view.depth.shape, 3), dtype=np.float32)


def _wood(points: Float[np.ndarray, "pixels 3"], seed: int) -> Float[np.ndarray, "pixels 3"]:
    """Return the unlit color (0 to 255) of the table: planks along x with a wavy grain."""
    rng = np.random.default_rng(seed)
    x, y = points[:, 0], points[:, 1] + rng.uniform(0.0, _PLANK_M)
    bend = 0.012 * np.sin(7.0 * x + rng.uniform(0.0, 6.0)) + 0.005 * np.sin(19.0 * x + 40.0 * y)
    tone = np.ones(len(points))
    for frequency, strength in ((60.0, 0.025), (170.0, 0.025), (410.0, 0.02)):
        tone += strength * np.sin(frequency * (y + bend) + rng.uniform(0.0, 6.0))
    plank = np.floor(y / _PLANK_M).astype(int)
    joint = np.abs(y / _PLANK_M - plank - 0.5) > 0.49
    tone += rng.uniform(-0.05, 0.05, 256)[plank % 256] - 0.2 * joint
    return np.array(_WOOD_COLOR) * tone[:, None]
