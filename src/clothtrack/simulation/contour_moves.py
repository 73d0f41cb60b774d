"""Compute the vertex moves of one round of untangling.

Every crossing contributes two directions. The local one shortens its contour at the crossing
(P. Volino, N. Magnenat-Thalmann, SIGGRAPH 2006, doi:10.1145/1141911.1142007;
`Contours.shortening`). The global one moves the sheets apart uniformly along the whole contour. It
is the sum of the local directions over the contour or, if the contour cuts a small piece off one
sheet, the direction straight back out of the other sheet (D. Baraff, A. Witkin, M. Kass,
"Untangling cloth", SIGGRAPH 2003, doi:10.1145/882262.882357, color such pieces in closed contours).
An open contour, which ends at a rim, also cuts off a piece if it is extended from there (M. Wicke,
H. Lanker, M. Gross, "Untangling cloth with boundaries", VMV 2006). Vertices belong to the side of
the contour that is nearer, in edges.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp
from jaxtyping import Bool, Float, Int, Int8

from clothtrack.geometry.intersections import Contours, SelfIntersection
from clothtrack.simulation import untangling_kernels as kernels

WHOLE = 2.0
"""Weight of the global direction of a contour, relative to 1 for the local one of a crossing."""

LARGEST = 0.25
"""Largest piece that is moved back, as a share of the cloth divided by the number of contours.
With many contours it is not known which piece is inside which."""

_COHERENT = 0.8
"""Minimum length of the mean normal along its contour for a piece to be moved back. The piece must
leave the other sheet in the same direction everywhere: a sleeve goes back through the hole; the
hole does not open."""

_LOCAL_BESIDE_PIECE = 0.3
"""Weight of the local direction of a crossing whose piece is moved back."""

_SHARE = 0.1
"""Weight that is added to every edge end and triangle corner, on top of its interpolation weight at
the crossing."""


@dataclass(frozen=True, eq=False)
class _Sheets:
    """One row for each sheet of each contour.

    Attributes:
        piece: vertices that the contour cuts off, the smaller part of the sheet.
        area: area of the piece [m^2].
        back: unit direction of the piece out of the other sheet.
        coherence: length of the mean of these directions along the contour.
    """

    contour: Int[np.ndarray, " sheets"]
    side: Int[np.ndarray, " sheets"]
    piece: Bool[np.ndarray, "sheets vertices"]
    area: Float[np.ndarray, " sheets"]
    back: Float[np.ndarray, "sheets 3"]
    coherence: Float[np.ndarray, " sheets"]


class ContourMoves:
    """Vertex moves that remove the contours of one mesh.

    Args:
        search: finds the contours; its mesh at rest defines the areas.
    """

    def __init__(self, search: SelfIntersection) -> None:
        self._search = search
        self._areas = search.mesh.vertex_areas
        ends = search.edges
        begin, reached = ends.T.reshape(-1), ends[:, ::-1].T.reshape(-1)
        order = np.argsort(begin, kind="stable")
        degrees = np.bincount(begin, minlength=search.mesh.vertex_count)
        joining = np.tile(np.arange(len(ends)), 2)
        self._graph = [
            self._upload(numbers)
            for numbers in (np.cumsum([0, *degrees]), reached[order], joining[order])
        ]

    def __call__(
        self, found: Contours, positions: Float[np.ndarray, "vertices 3"], *, pieces: bool
    ) -> Float[np.ndarray, "vertices 3"]:
        """Return the direction of each vertex, at most 1 long; 0 if no contour touches it.

        Args:
            positions: vertex positions [m].
        """
        search = self._search
        sides = found.sides[:, None]
        local = found.shortening / _at_least_one(found.shortening)
        whole = np.zeros((found.count, 3))
        np.add.at(whole, found.contour, sides * found.shortening)
        whole /= _at_least_one(whole)
        gathered = _Gathered(search.mesh.vertex_count)
        weight = np.ones(len(found))
        if pieces and found.sides.any():
            sheets = self._sheets(found, positions)
            taken = self._taken_back(sheets, found)
            whole[sheets.contour[taken]] = (sheets.side[:, None] * sheets.back)[taken]
            weight[np.isin(found.contour, sheets.contour[taken])] = _LOCAL_BESIDE_PIECE
            row, vertex = np.nonzero(sheets.piece[taken])
            gathered.add(vertex, np.ones(len(vertex)), sheets.back[taken][row])
        wanted = weight[:, None] * local + WHOLE * sides * whole[found.contour]
        wanted /= _at_least_one(wanted)
        first, second = search.edges[found.edges].T
        gathered.add(first, 1.0 - found.along + _SHARE, wanted)
        gathered.add(second, found.along + _SHARE, wanted)
        for corner, share in zip(search.mesh.faces[found.faces].T, found.within.T, strict=True):
            gathered.add(corner, share + _SHARE, -wanted)
        return gathered.mean

    def _sheets(self, found: Contours, positions: Float[np.ndarray, "vertices 3"]) -> _Sheets:
        """Return the piece that each contour cuts off each of its two sheets."""
        sheet = 2 * found.contour + (found.sides < 0)
        two_sided = np.flatnonzero(found.sides)
        order = two_sided[np.argsort(sheet[two_sided], kind="stable")]
        number, first = np.unique(sheet[order], return_index=True)
        labels = self._flooded(found, positions, order, first)
        above, below = ((labels == label) @ self._areas for label in (1, 2))
        back = np.add.reduceat(found.normals[order], first, axis=0)
        back *= np.where(above <= below, -1.0, 1.0)[:, None]
        length = np.linalg.norm(back, axis=1)
        return _Sheets(
            number // 2,
            1 - 2 * (number % 2),
            labels == np.where(above <= below, 1, 2)[:, None],
            np.minimum(above, below),
            back / np.maximum(length, 1e-12)[:, None],
            length / np.diff([*first, len(order)]),
        )

    def _flooded(
        self,
        found: Contours,
        positions: Float[np.ndarray, "vertices 3"],
        order: Int[np.ndarray, " two_sided"],
        first: Int[np.ndarray, " sheets"],
    ) -> Int8[np.ndarray, "sheets vertices"]:
        """Return 1 for vertices above the triangles that their sheet crosses, 2 for those below."""
        device, search = self._search.device, self._search
        edges = found.edges[order]
        ends = search.edges[edges]
        way = positions[ends[:, 1]] - positions[ends[:, 0]]
        rises = np.einsum("ci,ci->c", way, found.normals[order]) > 0.0
        seeds = np.where(rises[:, None], ends[:, ::-1], ends)
        shape = len(first), search.mesh.vertex_count
        labels = wp.zeros(shape, dtype=wp.int8, device=device)
        wp.launch(
            kernels.flood,
            dim=len(first),
            inputs=[
                self._upload(np.array([*first, len(order)])),
                self._upload(edges),
                self._upload(seeds),
                *self._graph,
                wp.zeros((len(first), len(search.edges)), dtype=wp.uint8, device=device),
                wp.empty(shape, dtype=int, device=device),
            ],
            outputs=[labels],
            device=device,
        )
        return labels.numpy()

    def _taken_back(self, sheets: _Sheets, found: Contours) -> Int[np.ndarray, " taken"]:
        """Return the sheets whose piece is moved back: the smaller allowed one of each contour."""
        ends, corners = self._search.edges[found.edges], self._search.mesh.faces[found.faces]
        inside = sheets.piece[:, ends].all(axis=2) | sheets.piece[:, corners].all(axis=2)
        tangled = (inside & (found.contour != sheets.contour[:, None])).any(axis=1)
        largest = LARGEST * self._areas.sum() / found.count
        may = np.flatnonzero((sheets.coherence > _COHERENT) & (sheets.area < largest) & ~tangled)
        may = may[np.argsort(sheets.area[may], kind="stable")]
        return may[np.unique(sheets.contour[may], return_index=True)[1]]

    def _upload(self, numbers: Int[np.ndarray, "*shape"]) -> wp.array:
        return wp.array(
            np.ascontiguousarray(numbers, np.int32), dtype=int, device=self._search.device
        )


class _Gathered:
    """Weighted mean of the moves of each vertex."""

    def __init__(self, vertex_count: int) -> None:
        self._sums = np.zeros((vertex_count, 3))
        self._weights = np.zeros(vertex_count)

    def add(
        self,
        vertices: Int[np.ndarray, " moves"],
        weights: Float[np.ndarray, " moves"],
        moves: Float[np.ndarray, "moves 3"],
    ) -> None:
        """Add moves of vertices."""
        np.add.at(self._sums, vertices, weights[:, None] * moves)
        np.add.at(self._weights, vertices, weights)

    @property
    def mean(self) -> Float[np.ndarray, "vertices 3"]:
        """Mean move of each vertex; 0 without moves."""
        return self._sums / np.where(self._weights > 0.0, self._weights, 1.0)[:, None]


def _at_least_one(vectors: Float[np.ndarray, "vectors 3"]) -> Float[np.ndarray, "vectors 1"]:
    """Return the lengths of the vectors, but at least 1."""
    return np.maximum(1.0, np.linalg.norm(vectors, axis=1, keepdims=True))
