"""The cloth as planning sees it: few vertices, so that a hundred futures are affordable."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from clothtrack.files.bounds import Bounds, Checked, Positive
from clothtrack.garments.garment_meshes import DEFAULT_SIZES_M, garment
from clothtrack.geometry.closest_point import closest_on_mesh
from clothtrack.geometry.mesh import ClothMesh

LAYERS = {"towel": 1.0, "tshirt": 1.2}
"""Area of all layers of a garment over width times length, about."""

_COUNTED_AREA = 1.0 / 1.08
"""A triangular or square lattice has this many vertices per square of its spacing, with hems."""

_FEWEST = 64
"""Vertices below which a garment's outline is lost."""


@dataclass(frozen=True)
class CoarseConfig(Checked):
    """How coarse planning is.

    Attributes:
        spacing_m: length of an edge [m]; the reference code clusters to 0.025, which takes a small
            towel's folds away (docs/notebook/flattening.md).
        most_vertices: never more than this, however large the garment.
    """

    spacing_m: Positive = 0.015
    most_vertices: Annotated[int, Bounds(least=_FEWEST)] = 700


class Coarsener:
    """Lays a coarse mesh of the same garment into a fine one; the fine one may be anywhere.

    Each coarse vertex is a material point of the fine cloth, found once through the canonical
    coordinates. Garments of another kind than those that can be made are planned as they are.

    Attributes:
        flat: the coarse garment at rest [m].
        stands_for: for each vertex of the fine garment, the coarse one nearest to it in the flat
            garment; None: they are the same.
    """

    def __init__(self, flat: ClothMesh, kind: str, config: CoarseConfig | None = None) -> None:
        """Find the coarse garment's points in the fine one.

        Args:
            flat: the fine garment at rest [m], with canonical coordinates.
            kind: the garment.
            config: how coarse.
        """
        config = config or CoarseConfig()
        self._faces = flat.faces
        self._face_of: np.ndarray | None = None
        self.flat = flat
        self.stands_for: Int[np.ndarray, " fine_vertices"] | None = None
        if kind not in DEFAULT_SIZES_M or flat.canonical is None:
            return
        width, length = (float(side) for side in np.ptp(flat.canonical[:, :2], axis=0))
        wanted = LAYERS[kind] * width * length / config.spacing_m**2 / _COUNTED_AREA
        count = int(min(config.most_vertices, max(float(_FEWEST), wanted)))
        if count >= flat.vertex_count:
            return
        coarse = garment(kind, vertex_count=count, size_m=(width, length))
        middle = 0.5 * (flat.canonical.max(axis=0) + flat.canonical.min(axis=0))
        points = np.asarray(coarse.canonical) + [middle[0], middle[1], 0.0]
        self._face_of, self._weights = closest_on_mesh(
            points.astype(np.float64), flat.canonical.astype(np.float64), flat.faces
        )
        self.flat = coarse
        self.stands_for = cKDTree(points).query(flat.canonical)[1]

    def __call__(
        self, positions: Float[np.ndarray, "vertices 3"]
    ) -> Float[np.ndarray, "coarse_vertices 3"]:
        """Return where the coarse vertices are [m] when the fine ones are here [m]."""
        positions = np.asarray(positions, dtype=np.float64)
        if self._face_of is None:
            return positions.copy()
        corners = positions[self._faces[self._face_of]]
        return np.einsum("vk,vkc->vc", self._weights, corners)
