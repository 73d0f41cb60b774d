"""Contact between edges, which keeps creases of one layer out of another."""

import numpy as np
import warp as wp

from clothtrack.geometry.boxes import no_boxes
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.buffers import ClothBuffers
from clothtrack.simulation.contact import edge_contact_kernels as kernels
from clothtrack.simulation.contact.blocks_of_eight import Eights
from clothtrack.simulation.parameters import SolverConfig

_DISTANCE_SHARE = 0.5
"""Contact distance of edges as a share of that of layers. It is smaller because vertex-triangle
contact handles flat layers."""

_MARGIN_SHARE = 0.2
"""Margin beyond that distance within which edges are listed, as a share of the distance of layers;
their approach in the time until the next search is added."""

_FLAT_COSINE = 0.94
"""An edge is flat if the cosine between its triangles' normals exceeds this (20 degrees)."""


class EdgeContact:
    """Contact of edges with bent or open edges nearby; sides are those of the last search.

    It adds to the result of vertex-triangle contact, and stores nothing between searches.
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
        self._distance = _DISTANCE_SHARE * config.thickness_m
        self._margin = _MARGIN_SHARE * config.thickness_m
        # Two edges that cross between their ends have midpoints less than one length apart. Edges
        # farther apart than twice the reach are not listed, however fast they approach.
        self._reach = longest + config.thickness_m
        self._normals = wp.zeros((environments, len(mesh.faces)), dtype=wp.vec3, device=device)
        self._eights = Eights(mesh, mesh.edges[:, [0, 1, 1]], buffers)
        eights = len(self._eights.numbers)
        self._boxes = wp.array(no_boxes(environments, eights), dtype=float, device=device)
        self._bent = wp.zeros((environments, eights), dtype=wp.uint32, device=device)
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
        environments, eights = buffers.shape[0], self._eights
        faces = buffers.threads(len(buffers.faces))
        self._totals.zero_()
        wp.launch(
            kernels.find_normals,
            dim=(environments, faces),
            inputs=[faces, buffers.faces, buffers.positions],
            outputs=[self._normals],
            device=device,
        )
        wp.launch(
            kernels.fit_edges,
            dim=(environments, eights.threads),
            inputs=[
                eights.threads, buffers.clocks, _FLAT_COSINE, self._distance + self._margin,
                self._reach, eights.numbers, eights.corners, self._sides, self._normals,
                buffers.positions, buffers.velocities,
            ],
            outputs=[self._boxes, self._bent, eights.around],
            device=device,
        )  # fmt: skip
        eights.fit_top()
        wp.launch(
            kernels.find_edges,
            dim=(environments, eights.threads),
            inputs=[
                eights.threads, buffers.clocks, eights.numbers, eights.corners, self._boxes,
                self._bent, eights.around, eights.top, self._distance, self._margin, buffers.rest,
                buffers.positions, buffers.velocities,
            ],
            outputs=[
                self._partners, self._distances, self._counts, self._listed, self._totals,
                self._overflows,
            ],
            device=device,
        )  # fmt: skip

    def push(self) -> None:
        """Add the position changes from edges to those from triangles."""
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
    """Return the two triangles at each edge; the second is -1 at an open or branching edge."""
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
