"""The tool that moves the cloth: a tapered rod that reaches in from outside the picture."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

_SIDES = 12
RADII_M = ((0.0, 0.0015), (0.03, 0.003), (0.12, 0.008), (0.9, 0.012))
"""Distance from the tip [m] and radius there [m], for tweezers on a rod."""


@dataclass(frozen=True)
class Tool:
    """A rod with a constant direction; only its tip moves.

    Attributes:
        azimuth_rad: direction in which it leaves the tip, seen from above, from the x axis.
        radii_m: distance from the tip [m] and radius there [m], outwards.
    """

    azimuth_rad: float = np.pi / 2.0
    elevation_rad: float = float(np.radians(35.0))
    radii_m: tuple[tuple[float, float], ...] = RADII_M

    @classmethod
    def sample(cls, rng: np.random.Generator) -> "Tool":
        """Return a random tool that comes from the far side of the table."""
        return cls(
            azimuth_rad=float(np.pi / 2.0 + rng.uniform(-0.7, 0.7)),
            elevation_rad=float(np.radians(rng.uniform(28.0, 45.0))),
        )

    @property
    def axis(self) -> Float[np.ndarray, " 3"]:
        """Unit vector from the tip along the rod."""
        flat = np.cos(self.elevation_rad)
        return np.array(
            [
                flat * np.cos(self.azimuth_rad),
                flat * np.sin(self.azimuth_rad),
                np.sin(self.elevation_rad),
            ]
        )

    @property
    def faces(self) -> Int[np.ndarray, "faces 3"]:
        """Triangles of the rod, outward; the far end is open."""
        faces = []
        for ring in range(len(self.radii_m) - 1):
            for k in range(_SIDES):
                a, b = ring * _SIDES + k, ring * _SIDES + (k + 1) % _SIDES
                c, d = a + _SIDES, b + _SIDES
                faces += [(a, b, c), (b, d, c)]
        faces += [(0, k + 1, k) for k in range(1, _SIDES - 1)]
        return np.array(faces, dtype=np.int32)

    @property
    def tip_faces(self) -> Bool[np.ndarray, " faces"]:
        """Whether each triangle belongs to the tip, from its end to the first change of taper."""
        faces = np.zeros(2 * _SIDES * (len(self.radii_m) - 1) + _SIDES - 2, dtype=bool)
        faces[: 2 * _SIDES] = True
        faces[2 - _SIDES :] = True
        return faces

    def vertices(self, tip: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "vertices 3"]:
        """Return the vertices of the rod [m] for this tip position."""
        across = np.cross(self.axis, (0.0, 0.0, 1.0))
        across /= np.linalg.norm(across)
        up = np.cross(across, self.axis)
        turn = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
        ring = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * up
        rings = [tip + distance * self.axis + radius * ring for distance, radius in self.radii_m]
        return np.concatenate(rings)
