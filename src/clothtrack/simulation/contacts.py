"""How cloth keeps clear of cloth: what every contact model offers, balls, and nothing at all.

Each class lists candidates (`find`) once in a while and computes from them, in every substep, what
contact adds to the positions (`push`). Both only launch kernels, so that a graph can hold them.
"""

from typing import Protocol, runtime_checkable

import numpy as np
import warp as wp
from jaxtyping import Float32, Int32

from clothtrack.simulation import particle_contact_kernels as particles
from clothtrack.simulation.buffers import ClothBuffers
from clothtrack.simulation.parameters import SolverConfig

NEIGHBOURS_PER_VERTEX = 48
GRID_CELLS = 32


@runtime_checkable
class Contact(Protocol):
    """What the solver needs of a contact model."""

    overflows: wp.array

    def find(self) -> None:
        """List what may touch until the next call."""

    def push(self) -> None:
        """Compute from the lists what contact adds to the positions."""

    def memory(
        self,
    ) -> tuple[
        Int32[np.ndarray, "environments vertices slots"],
        Float32[np.ndarray, "environments vertices slots"],
        Int32[np.ndarray, "environments vertices"],
    ]:
        """Sides, distances and counts, as ContactMemory has them."""
        ...

    def restore(self, sides: np.ndarray, distances: np.ndarray, counts: np.ndarray) -> None:
        """Take the memory back."""


class NoContact:
    """Layers pass through each other."""

    def __init__(self, buffers: ClothBuffers) -> None:
        self._shape = buffers.shape
        self.overflows = wp.zeros(self._shape[0], dtype=int, device=buffers.positions.device)

    def find(self) -> None:
        """List nothing."""

    def push(self) -> None:
        """Add nothing."""

    def memory(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """No side is remembered."""
        environments, vertices = self._shape
        return (
            np.zeros((environments, vertices, 0), dtype=np.int32),
            np.zeros((environments, vertices, 0), dtype=np.float32),
            np.zeros((environments, vertices), dtype=np.int32),
        )

    def restore(self, sides: np.ndarray, distances: np.ndarray, counts: np.ndarray) -> None:
        """Nothing to restore."""


class ParticleContact(NoContact):
    """Every vertex is a ball; cheap, and right when the spacing is near the thickness."""

    def __init__(
        self, buffers: ClothBuffers, config: SolverConfig, particle_friction: wp.array
    ) -> None:
        super().__init__(buffers)
        self._buffers = buffers
        self._config = config
        self._friction = particle_friction
        device = buffers.positions.device
        environments, vertices = buffers.shape
        self._reach = config.thickness_m + config.contact_margin_m
        self._grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=device)
        owners = np.repeat(np.arange(environments, dtype=np.int32), vertices)
        self._owners = wp.array(owners, dtype=int, device=device)
        self.neighbours = wp.zeros(
            (environments, vertices, NEIGHBOURS_PER_VERTEX), dtype=int, device=device
        )
        self.counts = wp.zeros((environments, vertices), dtype=int, device=device)

    def find(self) -> None:
        """List the neighbours of each vertex."""
        buffers = self._buffers
        self._grid.build(buffers.positions.flatten(), self._reach, self._owners)
        wp.launch(
            particles.find_neighbours,
            dim=buffers.shape,
            inputs=[self._grid.id, self._reach, buffers.positions],
            outputs=[self.neighbours, self.counts, self.overflows],
            device=buffers.positions.device,
        )

    def push(self) -> None:
        """Push overlapping balls apart."""
        buffers = self._buffers
        wp.launch(
            particles.push_particles,
            dim=buffers.shape,
            inputs=[
                self._config.thickness_m,
                buffers.rest,
                self._friction,
                self.neighbours,
                self.counts,
                buffers.inverse_masses,
                buffers.positions,
                buffers.start,
            ],
            outputs=[buffers.moves, buffers.stops],
            device=buffers.positions.device,
        )
