"""Scores how well a mesh explains a picture: outline, surface, layers, tension and bending.

All terms are dimensionless and smaller for a better mesh, so that sizes and cuts of a garment are
comparable. A garment of a wrong size raises them: if too small, it is stretched or leaves part of
the cloth uncovered; if too large, it is compressed, reaches beyond the cloth or has ripples.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree
from scipy.stats import rankdata

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.seen_cloth import SeenCloth

OUTLINE, SURFACE, TENSION, LAYERS, BENDING = 1.0, 1.0, 2.0, 0.05, 0.005
"""Weights of the terms of `Explanation`. On simulated folds, each fitted in nine sizes and to
several answers of the network, they select nearly the true size and nearly the best answer.
Doubling or halving any of them changes little."""

CELLS = 16
"""Cells along each side of the picture in which layers are counted."""

_LEAST_CELLS = 6
"""With fewer cells than this, layers are not scored."""

_COVERED = 0.6
"""A cell counts when more than this share of it shows cloth."""


@dataclass(frozen=True)
class Explanation:
    """Misfit of a mesh to a picture, and its deformation.

    Attributes:
        outline: 1 minus intersection over union of the silhouettes from above.
        surface: root mean square distance between the visible and the measured surface, both
            directions, over the root of the observed area.
        tension: mean absolute relative change of the edge lengths.
        layers: 1 minus the rank correlation, over cells of the picture, of the cloth's height over
            the table with the number of mesh layers there; 1 with too few cells.
        bending: length of a garment's creases, each weighted by its angle over a half turn, over
            the longer side of the garment.
    """

    outline: float
    surface: float
    tension: float
    layers: float
    bending: float

    @property
    def score(self) -> float:
        """Weighted sum of the terms, which a search minimizes."""
        return (
            OUTLINE * self.outline
            + SURFACE * self.surface
            + TENSION * self.tension
            + LAYERS * self.layers
            + BENDING * self.bending
        )


class Explainer:
    """Explanations of one picture by meshes of one garment.

    Args:
        rest: the flat garment [m].
    """

    def __init__(self, rest: ClothMesh, cloth: SeenCloth, *, device: str = "cpu") -> None:
        self._rest, self._cloth = rest, cloth
        self._rasterizer = Rasterizer(rest.faces, cloth.camera, device=device)

    def __call__(self, vertices: Float[np.ndarray, "vertices 3"]) -> Explanation:
        """Return how well the garment with these vertices [m] explains the observed cloth."""
        cloth, rest = self._cloth, self._rest
        depth = self._rasterizer.render(vertices).depth
        drawn, seen = np.isfinite(depth), cloth.seen
        # In unobservable pixels, cover by the mesh is neither rewarded nor penalized.
        against = drawn & (seen | ~cloth.free)
        outline = 1.0 - (drawn & seen).sum() / max(int((against | seen).sum()), 1)
        ends = vertices[rest.edges]
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        return Explanation(
            outline=float(outline),
            surface=self._surface(np.where(drawn, depth, 0.0)),
            tension=float(np.abs(lengths / rest.edge_lengths - 1.0).mean()),
            layers=self._layers(vertices),
            bending=self._bending(vertices),
        )

    def _surface(self, depth: Float[np.ndarray, "height width"]) -> float:
        cloth = self._cloth
        every = np.zeros(depth.shape, bool)
        every[::2, ::2] = True
        surface = cloth.camera.back_project(depth, every)
        if not len(surface) or not len(cloth.points):
            return 1.0
        there, _ = cKDTree(surface).query(cloth.points)
        back, _ = cloth.tree.query(surface)
        both = 0.5 * (np.square(there).mean() + np.square(back).mean())
        return float(np.sqrt(both) / cloth.extent_m)

    def _layers(self, vertices: Float[np.ndarray, "vertices 3"]) -> float:
        cloth, camera = self._cloth, self._cloth.camera
        covered, height_m = cloth.cells(CELLS)
        a, b, c = np.moveaxis(vertices[self._rest.faces], 1, 0)
        u, v = (b - a)[:, :2], (c - a)[:, :2]
        area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        pixels, _ = camera.project((a + b + c) / 3.0)
        column, row = np.clip(
            pixels * CELLS / (camera.width, camera.height), 0, CELLS - 1
        ).astype(np.intp).T  # fmt: skip
        layers = np.bincount(row * CELLS + column, area, CELLS**2).reshape(CELLS, CELLS)
        chosen = covered > _COVERED
        if chosen.sum() < _LEAST_CELLS:
            return 1.0
        return 1.0 - _rank_correlation(layers[chosen] / covered[chosen], height_m[chosen])

    def _bending(self, vertices: Float[np.ndarray, "vertices 3"]) -> float:
        a, b, c = np.moveaxis(vertices[self._rest.faces], 1, 0)
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
        faces, lengths = self._hinges
        cosines = np.einsum("ij,ij->i", normals[faces[:, 0]], normals[faces[:, 1]])
        turned = np.arccos(np.clip(cosines, -1.0, 1.0)) / np.pi
        size_m = float(np.ptp(self._rest.vertices[:, :2], axis=0).max())
        return float((turned * lengths).sum()) / size_m

    @cached_property
    def _hinges(self) -> tuple[Int[np.ndarray, "hinges 2"], Float[np.ndarray, " hinges"]]:
        """The two faces at each interior edge, and its rest length [m]."""
        faces, count = self._rest.faces, np.int64(self._rest.vertex_count)
        sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        keys = sides[:, 0] * count + sides[:, 1]
        order = np.argsort(keys, kind="stable")
        first = np.flatnonzero(keys[order][1:] == keys[order][:-1])
        pairs = np.stack([order[first], order[first + 1]], axis=1)
        ends = self._rest.vertices[sides[pairs[:, 0]]]
        return pairs // 3, np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def _rank_correlation(a: Float[np.ndarray, " cells"], b: Float[np.ndarray, " cells"]) -> float:
    """Return Spearman's rank correlation; 0 if either input is constant."""
    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return 0.0
    return float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])
