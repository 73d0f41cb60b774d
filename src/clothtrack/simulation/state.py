"""What changes while a cloth moves, and what is asked of it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int32


@dataclass(frozen=True, eq=False)
class ContactMemory:
    """Which vertex is on which side of which triangle: what keeps layers in their order.

    Attributes:
        sides: triangle number + 1, positive when the vertex is on the side of the triangle's
            normal, negative when behind; 0 marks an empty slot.
        distances: distance that the pair keeps [m].
        counts: filled slots per vertex.
        airborne: substeps since the vertex last touched anything.
    """

    sides: Int32[np.ndarray, "environments vertices slots"]
    distances: Float32[np.ndarray, "environments vertices slots"]
    counts: Int32[np.ndarray, "environments vertices"]
    airborne: Int32[np.ndarray, "environments vertices"]


@dataclass(frozen=True, eq=False)
class ClothState:
    """Everything that the next step depends on, for one or many environments.

    Attributes:
        positions: vertices in the world [m].
        velocities: their velocities [m/s].
        contacts: the contacts' memory.
    """

    positions: Float32[np.ndarray, "environments vertices 3"]
    velocities: Float32[np.ndarray, "environments vertices 3"]
    contacts: ContactMemory

    @property
    def environments(self) -> int:
        """Number of environments."""
        return len(self.positions)

    def environment(self, index: int) -> "ClothState":
        """One environment alone."""
        one = slice(index, index + 1) if index != -1 else slice(index, None)
        memory = self.contacts
        return ClothState(
            self.positions[one],
            self.velocities[one],
            ContactMemory(
                memory.sides[one],
                memory.distances[one],
                memory.counts[one],
                memory.airborne[one],
            ),
        )


@dataclass(frozen=True, eq=False)
class Attachment:
    """Where vertices are pulled during a step. One environment stands for all of them.

    Attributes:
        targets: where attached vertices are to be at the end of the step [m], world.
        strength: 0 is free; 1 is held: moved there in a straight line, whatever it meets; between
            them the vertex closes this share of its distance to the target during the step, as
            far as stretch, contact and table let it.
    """

    targets: Float[np.ndarray, "environments vertices 3"]
    strength: Float[np.ndarray, "environments vertices"]
