"""State of a moving cloth, and attachments that pull its vertices."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32


@dataclass(frozen=True, eq=False)
class ContactMemory:
    """Stored side of each vertex-triangle pair, which keeps layers in their order.

    Attributes:
        sides: triangle number + 1, positive if the vertex is on the side of the triangle's
            normal, negative if behind; 0 marks an empty slot.
        distances: contact distance of the pair [m].
        airborne: substeps since the vertex last touched anything.
    """

    sides: Int32[np.ndarray, "environments vertices slots"]
    distances: Float32[np.ndarray, "environments vertices slots"]
    counts: Int32[np.ndarray, "environments vertices"]
    airborne: Int32[np.ndarray, "environments vertices"]

    def without(
        self, vertices: Bool[np.ndarray, " vertices"], faces: Int[np.ndarray, "faces 3"]
    ) -> "ContactMemory":
        """Return the memory without all pairs that contain these vertices, in any environment."""
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
    """Full state that the next step depends on, for one or many environments.

    Attributes:
        positions: vertices in the world [m].
        velocities: their velocities [m/s].
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
    """Targets of vertices during a step. One environment applies to all of them.

    Attributes:
        targets: positions of attached vertices at the end of the step [m], world.
        strength: 0 is free; 1 is held, that is moved to the target in a straight line through any
            obstacle; between them a critically damped spring that, from rest, closes this share of
            the distance during the step, as far as stretch, contact and table allow.
    """

    targets: Float[np.ndarray, "environments vertices 3"]
    strength: Float[np.ndarray, "environments vertices"]


# Share of the distance that a critically damped spring closes after rate x time, from rest.
_TURNS = np.linspace(0.0, 25.0, 5001)
_SHARES = 1.0 - (1.0 + _TURNS) * np.exp(-_TURNS)


def pull_rate(
    strength: Float[np.ndarray, "*axes"], duration_s: float
) -> Float[np.ndarray, "*axes"]:
    """Return the rate [1/s] of a critically damped spring that closes a share of its distance.

    From rest the share after a time t is 1 - (1 + r t) exp(-r t).
    """
    return np.interp(strength, _SHARES, _TURNS) / duration_s


def pull_strength(
    rate: Float[np.ndarray, "*axes"], duration_s: float
) -> Float[np.ndarray, "*axes"]:
    """Return the share of the distance that a spring of this rate [1/s] closes in a time.

    This is the inverse of `pull_rate`.
    """
    turns = np.asarray(rate) * duration_s
    return np.minimum(1.0 - (1.0 + turns) * np.exp(-turns), np.nextafter(1.0, 0.0))
