"""Contact between edges, which keeps creases of one layer out of another."""

import numpy as np
import warp as wp

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation import edge_contact_kernels as kernels
from clothtrack.simulation.buffers import ClothBuffers
from clothtrack.simulation.cells import CELLS_PER_ENVIRONMENT
from clothtrack.simulation.parameters import SolverConfig

DISTANCE_SHARE = 0.5
"""Distance that edges keep over that of layers: flat layers are left to vertices and triangles."""

MARGIN_SHARE = 0.2
"""Edges are listed this far beyond it, over the distance of layers, and by how fast they near."""

FLAT_COSINE = 0.94
"""An edge whose triangles' normals are nearer than this (20 degrees) is flat."""


class EdgeContact:
    """Edges against bent or open edges nearby; sides are those of the last search.

    Adds to what vertex-triangle contact has computed, and remembers nothing between searches.
    """

    def __init__(
        self,
        mesh: ClothMesh,
        buffers: ClothBuffers,
        config: SolverConfig,
        particle_friction: wp.array,
        overflows: wp.array,
    ) -> None:
        self._buffers, self._config, self._friction = buffers, config, particle_friction
        self._device = device = buffers.positions.device
        self._overflows = overflows
        environments, vertices = buffers.shape
        edges = len(mesh.edges)
        self._edges = wp.array(mesh.edges.astype(np.int32), dtype=wp.vec2i, device=device)
        self._sides = wp.array(_faces_beside(mesh), dtype=wp.vec2i, device=device)
        longest = 1.05 * float(mesh.edge_lengths.max())
        self._distance = DISTANCE_SHARE * config.thickness_m
        self._margin = MARGIN_SHARE * config.thickness_m
        # Two edges that pass between their ends have middles less than one length apart.
        self._reach = longest + config.thickness_m
        cells = environments * CELLS_PER_ENVIRONMENT
        self._cell_counts = wp.zeros(cells + 1, dtype=int, device=device)
        self._cell_first = wp.zeros(cells + 1, dtype=int, device=device)
        self._normals = wp.zeros((environments, len(mesh.faces)), dtype=wp.vec3, device=device)
        self._cells = wp.zeros((environments, edges), dtype=int, device=device)
        self._ranks = wp.zeros((environments, edges), dtype=int, device=device)
        self._balls = wp.zeros((environments, edges), dtype=wp.vec4, device=device)
        self._sorted = wp.zeros(environments * edges, dtype=int, device=device)
        self._sorted_balls = wp.zeros(environments * edges, dtype=wp.vec4, device=device)
        slots = (environments, edges, kernels.EDGES_PER_EDGE)
        self._partners = wp.zeros(slots, dtype=int, device=device)
        self._distances = wp.zeros(slots, dtype=float, device=device)
        self._counts = wp.zeros((environments, edges), dtype=int, device=device)
        self._listed = wp.zeros((environments, edges), dtype=int, device=device)
        self._totals = wp.zeros(environments, dtype=int, device=device)
        self._sums = wp.zeros((environments, vertices, 7), dtype=wp.int64, device=device)

    def find(self) -> None:
        """List the pairs of edges that may touch until the next call."""
        buffers, device = self._buffers, self._device
        environments, edges = self._counts.shape
        faces = buffers.threads(len(buffers.faces))
        threads = buffers.threads(edges)
        self._cell_counts.zero_()
        self._totals.zero_()
        wp.launch(
            kernels.find_normals,
            dim=(environments, faces),
            inputs=[faces, buffers.faces, buffers.positions],
            outputs=[self._normals],
            device=device,
        )
        wp.launch(
            kernels.count_bent,
            dim=(environments, threads),
            inputs=[
                threads, buffers.clocks, 1.0 / self._reach, FLAT_COSINE,
                self._distance + self._margin, self._edges, self._sides, self._normals,
                buffers.positions, buffers.velocities,
            ],
            outputs=[self._cell_counts, self._cells, self._ranks, self._balls],
            device=device,
        )  # fmt: skip
        wp.utils.array_scan(self._cell_counts, self._cell_first, inclusive=False)
        wp.launch(
            kernels.sort_bent,
            dim=(environments, threads),
            inputs=[threads, self._cell_first, self._cells, self._ranks, self._balls],
            outputs=[self._sorted, self._sorted_balls],
            device=device,
        )
        wp.launch(
            kernels.find_edges,
            dim=(environments, threads),
            inputs=[
                threads, buffers.clocks, 1.0 / self._reach, self._cell_first, self._cells,
                self._sorted, self._balls, self._sorted_balls, self._reach, self._distance,
                self._margin, self._edges, buffers.rest, buffers.positions, buffers.velocities,
            ],
            outputs=[
                self._partners, self._distances, self._counts, self._listed, self._totals,
                self._overflows,
            ],
            device=device,
        )  # fmt: skip

    def push(self) -> None:
        """Add what the edges want to what the triangles want."""
        buffers, device = self._buffers, self._device
        environments, edges = self._counts.shape
        threads, vertices = buffers.threads(edges), buffers.threads(buffers.shape[1])
        wp.launch(
            kernels.push_edges,
            dim=(environments, threads),
            inputs=[
                threads, buffers.clocks, self._config.push_out_speed, self._friction, self._edges,
                self._partners, self._distances, self._counts, self._listed, self._totals,
                buffers.inverse_masses, buffers.positions, buffers.start,
            ],
            outputs=[self._sums],
            device=device,
        )  # fmt: skip
        wp.launch(
            kernels.add_to_moves,
            dim=(environments, vertices),
            inputs=[vertices, self._totals, self._sums],
            outputs=[buffers.moves, buffers.stops],
            device=device,
        )


def _faces_beside(mesh: ClothMesh) -> np.ndarray:
    """The two triangles beside each edge; the second is -1 for an open or a branching edge."""
    sides = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    keys = sides[:, 0].astype(np.int64) * mesh.vertex_count + sides[:, 1]
    wanted = np.sort(mesh.edges, axis=1)
    wanted = wanted[:, 0].astype(np.int64) * mesh.vertex_count + wanted[:, 1]
    order = np.argsort(keys, kind="stable")
    begin = np.searchsorted(keys[order], wanted, side="left")
    count = np.searchsorted(keys[order], wanted, side="right") - begin
    first = order[begin] // 3
    second = order[np.minimum(begin + 1, len(order) - 1)] // 3
    return np.stack([first, np.where(count == 2, second, -1)], axis=1).astype(np.int32)
