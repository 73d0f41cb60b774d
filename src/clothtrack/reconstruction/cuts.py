"""Cuts that are tried for garments of unknown size, each in any width and length."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial

import numpy as np

from clothtrack.garments.garment_meshes import garment, shirt, trousers
from clothtrack.garments.outlines import ShirtOutline, TrousersOutline
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.isometric_fit import IsometricFit
from clothtrack.reconstruction.tokens.garment_tokens import GarmentTokens

TOWEL_ASPECTS = (1.0, 0.75, 0.55)
"""Shorter over longer side of the towels that a search starts from."""

_SHIRTS = {
    "wide T-shirt": ShirtOutline(),
    "narrow T-shirt": ShirtOutline(body=0.64, sleeve=0.2, sleeve_angle_rad=0.4),
    "sweater": ShirtOutline(body=0.8, sleeve=0.72, sleeve_angle_rad=0.75, cuff=0.14),
    "hooded sweater": ShirtOutline(
        body=0.8, sleeve=0.72, sleeve_angle_rad=0.75, cuff=0.14, hood=0.4, hood_width=0.2
    ),
}
"""Shirts that a search starts from."""

_TROUSERS = {
    "trousers": TrousersOutline(),
    "shorts": TrousersOutline(
        waist=0.36, hip=0.45, rise=0.5, spread_rad=0.15, thigh=0.47, cuff=0.4
    ),
}
"""Trousers that a search starts from."""


@dataclass(frozen=True, eq=False)
class KnownGarment:
    """A garment of known cut and size, with its tokens and its fit.

    Attributes:
        mesh: the flat garment, canonical coordinates filled [m].
    """

    cut: str
    mesh: ClothMesh
    tokens: GarmentTokens
    device: str = "cpu"

    @classmethod
    def of(cls, mesh: ClothMesh, cut: str = "template", *, device: str = "cpu") -> "KnownGarment":
        """Return a garment from its flat mesh."""
        return cls(cut, mesh, GarmentTokens.of(mesh), device)

    @cached_property
    def fit(self) -> IsometricFit:
        """Fit of the garment to pictures."""
        return IsometricFit(self.mesh, device=self.device)

    @cached_property
    def size_m(self) -> tuple[float, float]:
        """Width and length of the flat garment [m]."""
        width, length = np.ptp(np.asarray(self.mesh.canonical)[:, :2], axis=0)
        return float(width), float(length)

    def resized(self, width_m: float, length_m: float) -> "KnownGarment":
        """Return the same cut in another width and length.

        Args:
            width_m: width of the flat garment [m].
            length_m: length of the flat garment [m].
        """
        across, along = width_m / self.size_m[0], length_m / self.size_m[1]
        scale = np.array([across, along, np.sqrt(across * along)])
        canonical = np.asarray(self.mesh.canonical, np.float64) * scale
        mesh = replace(
            self.mesh, vertices=np.asarray(self.mesh.vertices) * scale, canonical=canonical
        )
        return KnownGarment(self.cut, mesh, self.tokens.stretched(mesh), self.device)


@lru_cache(maxsize=8)
def cuts(kind: str, vertex_count: int) -> tuple[KnownGarment, ...]:
    """Return the garments of a kind that a search starts from; the longer side is 1 m."""
    makers: dict[str, Callable[..., ClothMesh]] = {}
    if kind == "towel":
        for aspect in TOWEL_ASPECTS:
            makers[f"rectangle 1:{aspect:g}"] = partial(garment, "towel", size_m=(1.0, aspect))
    elif kind == "trousers":
        makers = {name: partial(trousers, cut, 1.0) for name, cut in _TROUSERS.items()}
    else:
        makers = {name: partial(shirt, cut, 1.0) for name, cut in _SHIRTS.items()}
    found = []
    for name, make in makers.items():
        mesh = make(vertex_count=vertex_count)
        longer = float(np.ptp(mesh.vertices[:, :2], axis=0).max())
        found.append(KnownGarment.of(mesh.scaled(1.0 / longer), name))
    return tuple(found)


def sized(
    kind: str, size_m: tuple[float, float], vertex_count: int, *, device: str = "cpu"
) -> KnownGarment:
    """Return a garment of a given size; for trousers, the cut with the most similar proportions.

    Args:
        size_m: width and length of the flat garment [m].
    """
    if kind != "trousers":
        mesh = garment(kind, vertex_count=vertex_count, size_m=size_m)
        return KnownGarment.of(mesh, kind, device=device)
    nearest = min(cuts(kind, vertex_count), key=partial(_apart, size_m))
    return replace(nearest.resized(*size_m), device=device)


def _apart(size_m: tuple[float, float], cut: KnownGarment) -> float:
    """Return the absolute difference of the logarithms of width over length."""
    asked, own = size_m[0] / size_m[1], cut.size_m[0] / cut.size_m[1]
    return abs(float(np.log(asked / own)))


def finer(coarse: KnownGarment, kind: str, vertex_count: int) -> KnownGarment:
    """Return the same garment with more vertices."""
    if kind == "towel":
        mesh = garment(kind, vertex_count=vertex_count, size_m=coarse.size_m)
        return KnownGarment.of(mesh, coarse.cut, device=coarse.device)
    fine = next(cut for cut in cuts(kind, vertex_count) if cut.cut == coarse.cut)
    return fine.resized(*coarse.size_m)
