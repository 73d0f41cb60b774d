"""How cloth keeps clear of cloth: what every contact model offers, and nothing at all.

Each class lists candidates (`find`) once in a while and computes from them, in every substep, what
contact adds to the positions (`push`). Both only launch kernels, so that a graph can hold them.
"""

from typing import Protocol, runtime_checkable

import numpy as np
import warp as wp
from jaxtyping import Float32, Int32

from clothtrack.simulation.buffers import ClothBuffers


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
        """Return sides, distances and counts, as ContactMemory has them."""
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
