"""How large a garment is that nobody has measured: as large as agrees with the picture.

Folds look much alike at all sizes; what tells is whether the mesh covers what was seen, no more and
no less, and lies as high.
"""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.depth_input import DepthInput
from clothtrack.reconstruction.tokens.token_reconstruction import TokenReconstructor, agreement
from clothtrack.simulation.garments import DEFAULT_SIZES_M, garment

if TYPE_CHECKING:
    from collections.abc import Iterator

SIZES = (0.8, 1.0, 1.25, 1.55, 1.95)
"""Longer sides that are tried, over the extent of what is seen: a fold or two hide the rest."""

TOWEL_ASPECTS = (1.0, 0.75, 0.55)
"""Shorter over longer side of towels that are tried."""


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
    best, highest = None, -np.inf
    for candidate in _candidates(picture, kind, vertex_count):
        answer = model.answer(picture, candidate, views=1)
        score = agreement(answer, candidate)
        if best is None or score > highest:
            best, highest = candidate, score
    assert best is not None
    return best


def _candidates(picture: DepthInput, kind: str, vertex_count: int) -> "Iterator[ClothMesh]":
    """Garments of the kind in all sizes that are tried."""
    extent_m = _extent_m(picture)
    width, length = DEFAULT_SIZES_M[kind]
    aspects = TOWEL_ASPECTS if kind == "towel" else (length / width,)
    for size in SIZES:
        for aspect in aspects:
            side_m = size * extent_m
            yield garment(kind, vertex_count=vertex_count, size_m=(side_m, aspect * side_m))


def _extent_m(picture: DepthInput) -> float:
    """The longest extent of what was seen, from above [m]."""
    shown = picture.mask & (picture.depth_m > 0)
    points: Float[np.ndarray, "points 3"] = picture.camera.back_project(picture.depth_m, shown)
    level = points[:, :2] - points[:, :2].mean(axis=0)
    angles = np.arange(0.0, np.pi, np.pi / 12.0)
    along = level @ np.stack([np.cos(angles), np.sin(angles)])
    low, high = np.percentile(along, [0.5, 99.5], axis=0)
    return float((high - low).max())
