"""How large a garment is that nobody has measured, and how it is cut: as agrees with the picture.

Folds look much alike at all sizes; what tells is whether the mesh covers what was seen, no more and
no less, and lies as high.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.depth_input import DepthInput
from clothtrack.reconstruction.tokens.garment_tokens import GarmentTokens
from clothtrack.reconstruction.tokens.token_reconstruction import TokenReconstructor, agreement
from clothtrack.simulation.garments import garment, shirt
from clothtrack.simulation.outlines import ShirtOutline

SIZES = (0.8, 1.0, 1.25, 1.55, 1.95)
"""Longer sides that are tried, over the extent of what is seen: a fold or two hide the rest."""

CLOSER = (0.89, 1.12)
"""By what the best of them is changed, and tried again."""

TOWEL_ASPECTS = (1.0, 0.75, 0.55)
"""Shorter over longer side of towels that are tried."""

SHIRT_CUTS = (
    ShirtOutline(),
    ShirtOutline(body=0.64, sleeve=0.2, sleeve_angle_rad=0.4),
    ShirtOutline(body=0.8, sleeve=0.72, sleeve_angle_rad=0.75, cuff=0.14),
)
"""Shirts that are tried: a wide T-shirt, a narrow one, a sweater."""


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A garment that may be what was seen."""

    mesh: ClothMesh
    tokens: GarmentTokens

    def scaled(self, factor: float) -> "_Candidate":
        """The same cut in another size."""
        return _Candidate(self.mesh.scaled(factor), self.tokens.scaled(factor))


def best_garment(
    model: TokenReconstructor, picture: DepthInput, kind: str, *, vertex_count: int = 1000
) -> ClothMesh:
    """The flat garment whose answer agrees best with the picture.

    Args:
        model: the network.
        picture: what was seen.
        kind: "towel" or "tshirt".
        vertex_count: of the mesh, about.

    Raises:
        InvalidRecordingError: there is no cloth in the picture.
    """

    def best(candidates: Iterable[_Candidate]) -> _Candidate:
        return max(candidates, key=agrees)

    def agrees(candidate: _Candidate) -> float:
        answer = model.answer(picture, candidate.mesh, tokens=candidate.tokens, views=1)
        return agreement(answer, candidate.mesh)

    extent_m = _extent_m(picture)
    found = best(cut.scaled(size * extent_m) for cut in _cuts(kind, vertex_count) for size in SIZES)
    return best([found, *(found.scaled(factor) for factor in CLOSER)]).mesh


@lru_cache(maxsize=4)
def _cuts(kind: str, vertex_count: int) -> tuple[_Candidate, ...]:
    """Garments of the kind whose longer side is a metre."""
    if kind == "towel":
        meshes = [
            garment("towel", vertex_count=vertex_count, size_m=(1.0, aspect))
            for aspect in TOWEL_ASPECTS
        ]
    else:
        meshes = [shirt(cut, 1.0, vertex_count=vertex_count) for cut in SHIRT_CUTS]
    found = []
    for mesh in meshes:
        unit = mesh.scaled(1.0 / float(np.ptp(mesh.vertices[:, :2], axis=0).max()))
        found.append(_Candidate(unit, GarmentTokens.of(unit)))
    return tuple(found)


def _extent_m(picture: DepthInput) -> float:
    """The longest extent of what was seen, from above [m]."""
    shown = picture.mask & (picture.depth_m > 0)
    points: Float[np.ndarray, "points 3"] = picture.camera.back_project(picture.depth_m, shown)
    level = points[:, :2] - points[:, :2].mean(axis=0)
    angles = np.arange(0.0, np.pi, np.pi / 12.0)
    along = level @ np.stack([np.cos(angles), np.sin(angles)])
    low, high = np.percentile(along, [0.5, 99.5], axis=0)
    return float((high - low).max())
