"""Coarse cloth meshes for planning, cheap enough for a hundred rollouts."""

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
"""Approximate area of all layers of a garment over width times length."""

_COUNTED_AREA = 1.0 / 1.08
"""Area per vertex of a triangular or square lattice, hems included, over its squared spacing."""

_FEWEST = 64
"""Vertex count below which a garment's outline is lost."""


@dataclass(frozen=True)
class CoarseConfig(Checked):
    """Resolution of the planning mesh.

    Attributes:
        spacing_m: edge length [m]; the reference code clusters to 0.025, which removes the folds of
            a small towel (docs/notebook/flattening.md).
        most_vertices: largest number of vertices, whatever the garment's size.
    """

    spacing_m: Positive = 0.015
    most_vertices: Annotated[int, Bounds(least=_FEWEST)] = 700


class Coarsener:
    """Map from a fine mesh in any state to a coarse mesh of the same garment.

    Each coarse vertex is a material point of the fine cloth, found once through the canonical
    coordinates. A garment of a kind that cannot be generated keeps its fine mesh.

    Attributes:
        flat: the coarse garment at rest [m].
        stands_for: for each vertex of the fine garment, the nearest coarse vertex in the flat
            garment; None: the meshes are the same.
    """

    def __init__(self, flat: ClothMesh, kind: str, config: CoarseConfig | None = None) -> None:
        """Locate the coarse vertices in the fine mesh.

        Args:
            flat: the fine garment at rest [m], with canonical coordinates.
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
        """Return the coarse vertices [m] for given positions of the fine ones [m]."""
        positions = np.asarray(positions, dtype=np.float64)
        if self._face_of is None:
            return positions.copy()
        corners = positions[self._faces[self._face_of]]
        return np.einsum("vk,vkc->vc", self._weights, corners)
