"""Find the edges of a mesh that pass through its triangles, for any vertex positions."""

import numpy as np
import warp as wp
from jaxtyping import Float, Int

from clothtrack.geometry import crossing_kernels as kernels
from clothtrack.geometry.boxes import EIGHT, along_curve, blocks, no_boxes


class CrossingSearch:
    """Reusable search for self-crossings of one mesh with at least one triangle."""

    def __init__(
        self,
        edges: Int[np.ndarray, "edges 2"],
        faces: Int[np.ndarray, "faces 3"],
        *,
        device: str = "cpu",
    ) -> None:
        self.edges, self.faces, self._device = edges, faces, device
        self._first_edges = EIGHT * blocks(len(faces), EIGHT**2)
        self._eights = self._first_edges + blocks(len(edges), EIGHT)
        self._numbers = np.zeros(EIGHT * self._eights, np.int64)
        self._corners: wp.array | None = None
        self._boxes = wp.array(no_boxes(self._eights), dtype=float, device=device)
        around = no_boxes(blocks(self._eights, EIGHT))
        self._around = wp.array(around, dtype=float, device=device)
        self._found = wp.empty(len(edges), dtype=wp.vec2i, device=device)
        self._count = wp.zeros(1, dtype=int, device=device)

    def pairs(
        self, vertices: Float[np.ndarray, "vertices 3"]
    ) -> tuple[Int[np.ndarray, " crossings"], Int[np.ndarray, " crossings"]]:
        """Return edges and the triangles without a common vertex that they pass through.

        They are sorted by edge index, then by triangle index. Positions [m] must be finite.
        """
        exact = np.ascontiguousarray(vertices, np.float64)
        if self._corners is None:
            self._corners = self._ordered(exact)
        # Allow many times the rounding error of single precision.
        slack = 1e-6 * float(np.abs(exact).max(initial=0.0))
        wp.launch(
            kernels.find_boxes,
            dim=self._eights,
            inputs=[
                wp.array(exact.astype(np.float32), dtype=wp.vec3, device=self._device),
                self._corners,
                self._first_edges,
                slack,
            ],
            outputs=[self._boxes, self._around],
            device=self._device,
        )
        points = wp.array(exact, dtype=wp.vec3d, device=self._device)
        count = self._list(points)
        if count > len(self._found):
            self._found = wp.empty(count, dtype=wp.vec2i, device=self._device)
            self._list(points)
        edge, face = self._numbers[self._found.numpy()[:count]].T
        edge, face = np.divmod(np.sort(edge * len(self.faces) + face), len(self.faces))
        return edge, face

    def _list(self, points: wp.array) -> int:
        """Launch the search; return the number of crossings, which may exceed those listed."""
        self._count.zero_()
        wp.launch(
            kernels.list_crossings,
            dim=blocks(self._eights - self._first_edges, EIGHT),
            inputs=[points, self._corners, self._boxes, self._around, self._first_edges],
            outputs=[self._found, self._count],
            device=self._device,
        )
        return int(self._count.numpy()[0])

    def _ordered(self, vertices: Float[np.ndarray, "vertices 3"]) -> wp.array:
        """Return the vertices of triangles and edges, sorted so that near ones share a block.

        They stay near each other because they belong to one cloth. An edge repeats its second
        vertex.
        """
        corners = np.full((EIGHT * self._eights, 3), -1, np.int32)
        for start, given in (
            (0, self.faces),
            (EIGHT * self._first_edges, self.edges[:, [0, 1, 1]]),
        ):
            order = along_curve(vertices[given].mean(axis=1))
            there = slice(start, start + len(given))
            corners[there] = given[order]
            self._numbers[there] = order
        by_eight = corners.reshape(self._eights, EIGHT, 3).swapaxes(1, 2)
        return wp.array(np.ascontiguousarray(by_eight), dtype=int, device=self._device)
