"""Distance constraints of a cloth, ordered so that they can be solved in parallel."""

from dataclasses import dataclass

import numpy as np
import warp as wp
from jaxtyping import Float32, Int, Int32

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation import kernels, sweep_kernels


@dataclass(frozen=True, eq=False)
class DistanceConstraints:
    """Pairs of vertices with their rest distance, sorted by color.

    Attributes:
        lengths: rest distances [m].
        first: start of each color, and the end; no two pairs of one color share a vertex.
    """

    pairs: Int32[np.ndarray, "pairs 2"]
    lengths: Float32[np.ndarray, " pairs"]
    first: tuple[int, ...]

    @property
    def colors(self) -> list[tuple[int, int]]:
        """First pair and number of pairs of each color."""
        return [
            (start, end - start) for start, end in zip(self.first[:-1], self.first[1:], strict=True)
        ]


class DeviceConstraints:
    """Constraints on a device, and passes over them."""

    def __init__(
        self,
        constraints: DistanceConstraints,
        device: str,
        *,
        limit: float = 0.0,
        buckling: float = 1.0,
    ) -> None:
        self._device, self._is_cpu = device, wp.get_device(device).is_cpu
        self._pairs = [
            wp.array(constraints.pairs, dtype=wp.vec2i, device=device),
            wp.array(constraints.lengths, dtype=float, device=device),
        ]
        self._colors = constraints.colors
        self._bounds = wp.array(constraints.first, dtype=int, device=device)
        self._shape = [limit, buckling]

    def sweep(
        self, clocks: wp.array, compliances: wp.array, inverse_masses: wp.array, positions: wp.array
    ) -> None:
        """Launch one Gauss-Seidel pass over all pairs of every environment."""
        environments = positions.shape[0]
        material = [compliances, *self._shape, inverse_masses, positions]
        if self._is_cpu:
            wp.launch(
                sweep_kernels.sweep_constraints,
                dim=environments,
                inputs=[clocks, *self._pairs, self._bounds, *material],
                device=self._device,
            )
            return
        for first, count in self._colors:
            wp.launch(
                kernels.solve_distances,
                dim=(environments, count),
                inputs=[clocks, *self._pairs, first, *material],
                device=self._device,
            )


def stretch_constraints(mesh: ClothMesh) -> DistanceConstraints:
    """Return the edges of the mesh with their lengths in the mesh."""
    return _colored(mesh, mesh.edges)


def bend_constraints(mesh: ClothMesh) -> DistanceConstraints:
    """Return the vertex pairs opposite each other across an edge, with their mesh distances."""
    pairs = np.sort(mesh.opposite_pairs, axis=1)
    pairs = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
    return _colored(mesh, pairs.reshape(-1, 2))


def _color_pairs(pairs: Int[np.ndarray, "pairs 2"]) -> Int[np.ndarray, " pairs"]:
    """Return the lowest color that no earlier pair with a common vertex has (greedy coloring)."""
    used: dict[int, int] = {}
    colors = np.zeros(len(pairs), dtype=np.int64)
    for index, (first, second) in enumerate(pairs.tolist()):
        taken = used.get(first, 0) | used.get(second, 0)
        free = ~taken & (taken + 1)
        colors[index] = free.bit_length() - 1
        used[first] = used.get(first, 0) | free
        used[second] = used.get(second, 0) | free
    return colors


def _colored(mesh: ClothMesh, pairs: Int[np.ndarray, "pairs 2"]) -> DistanceConstraints:
    colors = _color_pairs(pairs)
    order = np.argsort(colors, kind="stable")
    pairs = np.ascontiguousarray(pairs[order], dtype=np.int32)
    counts = np.bincount(colors) if len(colors) else np.zeros(0, dtype=np.int64)
    first = (0, *np.cumsum(counts).tolist())
    ends = np.asarray(mesh.vertices, dtype=np.float64)[pairs]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).astype(np.float32)
    return DistanceConstraints(pairs, lengths, first)
