"""Memory of the solver on the device, shared by its kernels."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.kernels import Clock


@dataclass(frozen=True, eq=False)
class ClothBuffers:
    """Warp arrays of shape (environments, vertices) unless stated otherwise.

    Attributes:
        velocities: velocities of the state; within a substep those of the free flight.
        start: positions at the beginning of the substep.
        predicted: positions after free flight in the elastic substep.
        stops: the part of `moves` that ends an approach and changes the velocity.
        inverse_masses: inverse masses [1/kg]; 0 for held vertices.
        pull: rate at which a soft vertex approaches its goal [1/s]; 0 is free, -1 held.
        rest: positions of the rest shape (vertices).
        masses: mass of each vertex [kg] (vertices).
        substeps_left: remaining substeps of the step, one number.
        highest_speed: highest speed since the step began (environments).
    """

    positions: wp.array
    velocities: wp.array
    start: wp.array
    predicted: wp.array
    moves: wp.array
    stops: wp.array
    inverse_masses: wp.array
    pull: wp.array
    goals: wp.array
    airborne: wp.array
    rest: wp.array
    masses: wp.array
    faces: wp.array
    clocks: wp.array
    substeps_left: wp.array
    highest_speed: wp.array

    @property
    def shape(self) -> tuple[int, int]:
        """Environments and vertices."""
        return self.positions.shape

    def threads(self, count: int) -> int:
        """Return the threads for `count` items of an environment: one on a CPU, else `count`."""
        return 1 if wp.get_device(self.positions.device).is_cpu else count


def allocate(mesh: ClothMesh, area_density: float, environments: int, device: str) -> ClothBuffers:
    """Allocate the memory of a cloth that rests at the mesh's vertices."""
    shape = (environments, mesh.vertex_count)
    masses = (mesh.vertex_areas * area_density).astype(np.float32)
    rest = np.asarray(mesh.vertices, dtype=np.float32)

    def vectors() -> wp.array:
        return wp.zeros(shape, dtype=wp.vec3, device=device)

    everywhere = np.ascontiguousarray(np.broadcast_to(rest, (environments, *rest.shape)))
    weights = np.ascontiguousarray(np.broadcast_to(1.0 / masses, shape))
    return ClothBuffers(
        positions=wp.array(everywhere, dtype=wp.vec3, device=device),
        velocities=vectors(),
        start=vectors(),
        predicted=vectors(),
        moves=vectors(),
        stops=vectors(),
        inverse_masses=wp.array(weights, dtype=float, device=device),
        pull=wp.zeros(shape, dtype=float, device=device),
        goals=vectors(),
        airborne=wp.full(shape, 1000, dtype=int, device=device),
        rest=wp.array(rest, dtype=wp.vec3, device=device),
        masses=wp.array(masses, dtype=float, device=device),
        faces=wp.array(mesh.faces.astype(np.int32), dtype=wp.vec3i, device=device),
        clocks=wp.zeros(1, dtype=Clock, device=device),
        substeps_left=wp.zeros(1, dtype=int, device=device),
        highest_speed=wp.zeros(environments, dtype=float, device=device),
    )
