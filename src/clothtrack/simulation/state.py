"""What changes while a cloth moves, and what is asked of it."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32


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

    def without(
        self, vertices: Bool[np.ndarray, " vertices"], faces: Int[np.ndarray, "faces 3"]
    ) -> "ContactMemory":
        """Return the same without the pairs that some vertices are part of, in any environment.

        Args:
            vertices: that were moved past others: their sides are to be found anew.
            faces: the cloth's triangles.
        """
        triangle = np.abs(self.sides) - 1
        moved = vertices[faces].any(axis=1)[triangle] | vertices[:, None]
        kept = (self.sides != 0) & ~moved
        order = np.argsort(~kept, axis=2, kind="stable")
        sides = np.take_along_axis(np.where(kept, self.sides, 0), order, axis=2)
        distances = np.take_along_axis(np.where(kept, self.distances, 0.0), order, axis=2)
        counts = kept.sum(axis=2, dtype=np.int32)
        return replace(self, sides=sides, distances=distances.astype(np.float32), counts=counts)


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


@dataclass(frozen=True, eq=False)
class Attachment:
    """Where vertices are pulled during a step. One environment stands for all of them.

    Attributes:
        targets: where attached vertices are to be at the end of the step [m], world.
        strength: 0 is free; 1 is held: moved there in a straight line, whatever it meets; between
            them a critically damped spring that closes this share of the distance during the
            step from rest, as far as stretch, contact and table let it.
    """

    targets: Float[np.ndarray, "environments vertices 3"]
    strength: Float[np.ndarray, "environments vertices"]


# Share that a critically damped spring has closed after rate x time, starting at rest.
_TURNS = np.linspace(0.0, 25.0, 5001)
_SHARES = 1.0 - (1.0 + _TURNS) * np.exp(-_TURNS)


def pull_rate(
    strength: Float[np.ndarray, "*axes"], duration_s: float
) -> Float[np.ndarray, "*axes"]:
    """Rate [1/s] of the critically damped spring that closes a share of its way in a time.

    From rest the share after a time t is 1 - (1 + r t) exp(-r t).
    """
    return np.interp(strength, _SHARES, _TURNS) / duration_s


def pull_strength(
    rate: Float[np.ndarray, "*axes"], duration_s: float
) -> Float[np.ndarray, "*axes"]:
    """Return the share of the way that a spring of this rate [1/s] closes in a time.

    Undoes `pull_rate`.
    """
    turns = np.asarray(rate) * duration_s
    return np.minimum(1.0 - (1.0 + turns) * np.exp(-turns), np.nextafter(1.0, 0.0))
