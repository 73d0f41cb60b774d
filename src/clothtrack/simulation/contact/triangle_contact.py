"""Contact between vertices and triangles, which stores on which side each vertex is."""

import numpy as np
import warp as wp

from clothtrack.geometry.boxes import EIGHT, no_boxes
from clothtrack.geometry.device_arrays import overwrite
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.buffers import ClothBuffers
from clothtrack.simulation.contact import triangle_contact_kernels as triangles
from clothtrack.simulation.contact import triangle_push_kernels as pushes
from clothtrack.simulation.contact.blocks_of_eight import Eights, in_eights
from clothtrack.simulation.contact.edge_contact import EdgeContact
from clothtrack.simulation.contact.triangle_contact_kernels import TRIANGLES_PER_VERTEX
from clothtrack.simulation.parameters import CONTACT_TOLERANCE, SolverConfig

_REACTIONS_PER_VERTEX = 48


class TriangleContact:
    """Contact of vertices with triangles; each pair stores its side."""

    def __init__(
        self,
        mesh: ClothMesh,
        buffers: ClothBuffers,
        config: SolverConfig,
        particle_friction: wp.array,
    ) -> None:
        self.buffers = buffers
        self._config = config
        self._friction = particle_friction
        self._device = device = buffers.positions.device
        environments, vertices = buffers.shape
        reach = _face_reach(mesh, config)
        self._face_reach = wp.array(np.square(reach).astype(np.float32), dtype=float, device=device)
        self._eights = Eights(mesh, mesh.faces, buffers)
        # NaN planes fill the last block of eight, because no point is ever near a NaN plane.
        planes = np.full((environments, len(self._eights.numbers), 12, EIGHT), np.nan, np.float32)
        self._planes = wp.array(planes, dtype=float, device=device)
        self._groups = wp.array(in_eights(mesh.vertices), dtype=int, device=device)
        points = no_boxes(environments, len(self._groups))
        self._points = wp.array(points, dtype=float, device=device)
        slots = (environments, vertices, TRIANGLES_PER_VERTEX)
        self.sides = wp.zeros(slots, dtype=int, device=device)
        self.distances = wp.zeros(slots, dtype=float, device=device)
        self.counts = wp.zeros((environments, vertices), dtype=int, device=device)
        self._old_sides = wp.zeros_like(self.sides)
        self._old_distances = wp.zeros_like(self.distances)
        self._old_counts = wp.zeros_like(self.counts)
        self.overflows = wp.zeros(environments, dtype=int, device=device)
        self._push = (_ScatteredPush if wp.get_device(device).is_cpu else GatheredPush)(self)
        self._edges = (
            EdgeContact(mesh, buffers, config, particle_friction, self.overflows)
            if config.edge_contact
            else None
        )

    def find(self) -> None:
        """List vertex-triangle pairs with their sides, and prepare to push them apart."""
        buffers, config, device = self.buffers, self._config, self._device
        wp.copy(self._old_sides, self.sides)
        wp.copy(self._old_distances, self.distances)
        wp.copy(self._old_counts, self.counts)
        self._fit()
        eights, threads = self._eights, buffers.threads(len(self._groups))
        wp.launch(
            triangles.find_pairs,
            dim=(buffers.shape[0], threads),
            inputs=[
                threads, buffers.clocks, self._groups, eights.numbers, eights.corners,
                self._planes, eights.around, eights.top, self._points, self._face_reach,
                config.thickness_m, config.contact_margin_m, config.contact_depth_m,
                CONTACT_TOLERANCE, buffers.faces, buffers.rest, buffers.positions,
                buffers.velocities, self._old_sides, self._old_distances, self._old_counts,
            ],
            outputs=[self.sides, self.distances, self.counts, self.overflows],
            device=device,
        )  # fmt: skip
        self._push.prepare()
        if self._edges is not None:
            self._edges.find()

    def _fit(self) -> None:
        """Fit planes and boxes to where the triangles are now."""
        buffers, eights = self.buffers, self._eights
        wp.launch(
            triangles.fit_triangles,
            dim=(buffers.shape[0], eights.threads),
            inputs=[
                eights.threads, self._config.contact_depth_m, CONTACT_TOLERANCE, eights.numbers,
                eights.corners, self._face_reach, buffers.positions,
            ],
            outputs=[self._planes, eights.around],
            device=self._device,
        )  # fmt: skip
        eights.fit_top()

    def push(self) -> None:
        """Compute the position changes from contact."""
        self._push.launch()
        if self._edges is not None:
            self._edges.push()

    @property
    def impulse_inputs(self) -> list[object]:
        """First inputs of every kernel that computes impulses."""
        config = self._config
        return [self.buffers.clocks, CONTACT_TOLERANCE, config.push_out_speed, self._friction]

    def memory(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the lists; unused slots are cleared, so that equal states have equal bits."""
        counts = self.counts.numpy().copy()
        filled = np.arange(TRIANGLES_PER_VERTEX) < counts[..., None]
        sides = np.where(filled, self.sides.numpy(), 0).astype(np.int32)
        distances = np.where(filled, self.distances.numpy(), 0).astype(np.float32)
        return sides, distances, counts

    def restore(self, sides: np.ndarray, distances: np.ndarray, counts: np.ndarray) -> None:
        """Restore the lists."""
        overwrite(self.sides, sides)
        overwrite(self.distances, distances)
        overwrite(self.counts, counts)


class _ScatteredPush:
    """Push on a CPU: go through an environment's pairs and add each impulse to its vertices.

    On a CPU threads run one after another.
    """

    def __init__(self, contact: TriangleContact) -> None:
        self._contact = contact
        self._device = device = contact.buffers.positions.device
        self._active = wp.zeros(contact.buffers.shape, dtype=float, device=device)

    def prepare(self) -> None:
        """Prepare nothing: the pairs are read where `find` listed them."""

    def launch(self) -> None:
        """Compute the position changes from contact."""
        contact, buffers = self._contact, self._contact.buffers
        wp.launch(
            pushes.scatter_impulses,
            dim=buffers.shape[0],
            inputs=[
                *contact.impulse_inputs, buffers.faces, contact.sides, contact.distances,
                contact.counts, buffers.inverse_masses, buffers.positions, buffers.start,
            ],
            outputs=[self._active, buffers.moves, buffers.stops],
            device=self._device,
        )  # fmt: skip


class GatheredPush:
    """Push on a GPU: store the impulse of each pair, then gather the impulses of each vertex.

    Every corner of a triangle has a list of its pairs.
    """

    def __init__(self, contact: TriangleContact) -> None:
        self._contact = contact
        buffers = contact.buffers
        self._device = device = buffers.positions.device
        slots = (*buffers.shape, TRIANGLES_PER_VERTEX)
        self._impulses = wp.zeros(slots, dtype=wp.vec3, device=device)
        self._stopping = wp.zeros(slots, dtype=wp.vec3, device=device)
        self._weights = wp.zeros(slots, dtype=wp.vec3, device=device)
        self._reactions = wp.zeros(
            (*buffers.shape, _REACTIONS_PER_VERTEX), dtype=int, device=device
        )
        self._reaction_counts = wp.zeros(buffers.shape, dtype=int, device=device)

    def prepare(self) -> None:
        """List for every corner the pairs that push it."""
        contact, buffers = self._contact, self._contact.buffers
        self._reaction_counts.zero_()
        wp.launch(
            pushes.list_reactions,
            dim=buffers.shape,
            inputs=[buffers.faces, contact.sides, contact.counts],
            outputs=[self._reactions, self._reaction_counts, contact.overflows],
            device=self._device,
        )
        wp.launch(
            pushes.sort_reactions,
            dim=buffers.shape,
            inputs=[self._reactions, self._reaction_counts],
            device=self._device,
        )

    def launch(self) -> None:
        """Compute the impulse of each pair, then the position change of each vertex."""
        contact, buffers = self._contact, self._contact.buffers
        wp.launch(
            pushes.find_impulses,
            dim=buffers.shape,
            inputs=[
                *contact.impulse_inputs, buffers.faces, contact.sides, contact.distances,
                contact.counts, buffers.inverse_masses, buffers.positions, buffers.start,
            ],
            outputs=[self._impulses, self._stopping, self._weights],
            device=self._device,
        )  # fmt: skip
        wp.launch(
            pushes.gather_impulses,
            dim=buffers.shape,
            inputs=[
                contact.counts,
                self._reactions,
                self._reaction_counts,
                self._impulses,
                self._stopping,
                self._weights,
                buffers.inverse_masses,
            ],
            outputs=[buffers.moves, buffers.stops],
            device=self._device,
        )


def _face_reach(mesh: ClothMesh, config: SolverConfig) -> np.ndarray:
    """Return the radius around each triangle's center within which a vertex may touch it [m].

    A barycentric tolerance t scales a triangle by 1 + 3 t about its center; 5 % more allows for
    stretch.
    """
    corners = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]
    radius = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    flat = 1.05 * (1.0 + 3.0 * CONTACT_TOLERANCE) * radius
    return np.hypot(flat, config.contact_depth_m)
