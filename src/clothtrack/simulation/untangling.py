"""Remove self-intersections of a cloth without knowing its history.

Contact stores on which side of each other two layers were, and cannot undo a crossing that it
stored the wrong way round. Untangling needs no history. It moves the two sheets of each
intersection contour apart until no contour is left (`contour_moves`). After every move a few passes
over the edges restore their lengths (XPBD, as in the solver).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp
from jaxtyping import Float
from scipy import sparse

from clothtrack.geometry.intersections import Contours, SelfIntersection
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Table
from clothtrack.simulation import kernels
from clothtrack.simulation.constraints import DeviceConstraints, stretch_constraints
from clothtrack.simulation.contour_moves import ContourMoves
from clothtrack.simulation.parameters import RESTING_HEIGHT_M

STEPS = 0.6, 0.12
"""Longest move of a vertex in the first and in the last possible round, in median edge lengths.
Moves of a fifth of this leave many times the crossings, because they cannot step over folds that
are smaller than an edge."""

REACH = 4
"""Distance from a moved vertex, in edges, within which lengths are kept and vertices may move."""

_SWEEPS = 6
"""Passes over the edges after each move."""

_GIVE = 0.2
"""Compliance of an edge in a pass, relative to 2 for its two vertices."""

PATIENCE = 10
"""Rounds without fewer crossings before the strategy changes between moving small pieces back and
shortening alone. Untangling ends after two changes without success."""

_STRAIGHTENING = 8
"""Maximum passes that straighten edges further at the end, while no crossing comes back."""

_BACK_OUT = 0.1
"""Step that removes a crossing caused by straightening, in median edge lengths."""


@dataclass(frozen=True, eq=False)
class Untangling:
    """Result of untangling a cloth.

    Attributes:
        positions: vertex positions [m] with the fewest crossings of all rounds. Vertices far from
            any crossing are unchanged to the bit.
        crossings_before: edges that passed through a triangle (`geometry.quality: crossings`).
        crossings_after: edges that still do; untangling failed if this is not 0.
    """

    positions: Float[np.ndarray, "vertices 3"]
    crossings_before: int
    crossings_after: int
    rounds: int


def untangled(
    mesh: ClothMesh,
    positions: Float[np.ndarray, "vertices 3"],
    *,
    mobility: Float[np.ndarray, " vertices"] | None = None,
    table: Table | None = None,
    rounds: int = 80,
    device: str = "cpu",
) -> Untangling:
    """Return the cloth with as few self-intersections as possible.

    Args:
        positions: current vertex positions [m].
    """
    return Untangler(mesh, device=device)(positions, mobility=mobility, table=table, rounds=rounds)


class Untangler:
    """Reusable `untangled` for one cloth; what only crossings need is built at the first one.

    Args:
        mesh: the cloth; its vertices define the rest lengths of the edges.
    """

    def __init__(self, mesh: ClothMesh, *, device: str = "cpu") -> None:
        self._mesh, self._device = mesh, device
        self.edge_m = float(np.median(mesh.edge_lengths))
        self.search = SelfIntersection(mesh, device=device)

    def __call__(
        self,
        positions: Float[np.ndarray, "vertices 3"],
        *,
        mobility: Float[np.ndarray, " vertices"] | None = None,
        table: Table | None = None,
        rounds: int = 80,
    ) -> Untangling:
        """Return the same as `untangled`."""
        given = np.asarray(positions)
        ready = np.ones(len(given)) if mobility is None else np.asarray(mobility, np.float64)
        return _Attempt(self, given, ready, table).run(rounds)

    @cached_property
    def moves(self) -> ContourMoves:
        """Vertex moves that shorten contours."""
        return ContourMoves(self.search)

    @cached_property
    def keep_lengths(self) -> "_Lengths":
        """Passes over the edges."""
        return _Lengths(self._mesh, self._device)

    @cached_property
    def joined(self) -> sparse.csr_array:
        """Adjacency matrix of the vertices."""
        i, j = self._mesh.edges.T
        ends = np.concatenate([i, j]), np.concatenate([j, i])
        ones = np.ones(2 * len(i), np.int8)
        return sparse.coo_array((ones, ends), (self._mesh.vertex_count,) * 2).tocsr()


class _Attempt:
    """One untangling run and its best result so far."""

    def __init__(
        self,
        cloth: Untangler,
        given: Float[np.ndarray, "vertices 3"],
        mobility: Float[np.ndarray, " vertices"],
        table: Table | None,
    ) -> None:
        self._cloth, self._search, self._edge_m = cloth, cloth.search, cloth.edge_m
        self._precision, self._mobility, self._table = given.dtype, mobility, table
        self._best = given.astype(np.float64)
        self._free = np.zeros(len(given), dtype=bool)
        if table is not None:
            self._lowest = np.minimum(_heights(self._best, table), RESTING_HEIGHT_M)

    def run(self, rounds: int) -> Untangling:
        """Move until there are no crossings, no progress, or no rounds left."""
        positions = self._best
        found = self._search.contours(positions)
        before = fewest = found.crossing_edges
        pieces, waited, changes, number = True, 0, 0, 0
        while number < rounds and fewest and changes < 3:
            share = number / rounds
            step_m = self._edge_m * ((1.0 - share) * STEPS[0] + share * STEPS[1])
            positions = self._moved(positions, found, step_m, pieces=pieces)
            found = self._search.contours(positions)
            number, waited = number + 1, waited + 1
            if found.crossing_edges < fewest:
                self._best, fewest, waited, changes = positions, found.crossing_edges, 0, 0
            elif waited == PATIENCE:
                pieces, waited, changes = not pieces, 0, changes + 1
                positions, found = self._best, self._search.contours(self._best)
        if fewest < before:
            self._straighten(fewest)
        return Untangling(self._best.astype(self._precision), before, fewest, number)

    def _moved(
        self,
        positions: Float[np.ndarray, "vertices 3"],
        found: Contours,
        step_m: float,
        *,
        pieces: bool,
        sweeps: int = _SWEEPS,
    ) -> Float[np.ndarray, "vertices 3"]:
        move = step_m * self._cloth.moves(found, positions, pieces=pieces)
        move *= self._mobility[:, None]
        near = (move != 0.0).any(axis=1)
        for _ in range(REACH):
            near |= self._cloth.joined @ near > 0
        self._free |= near & (self._mobility > 0.0)
        # Adding zero to a negative zero would change its bits.
        return self._kept(np.where(self._free[:, None], positions + move, positions), sweeps)

    def _kept(
        self, positions: Float[np.ndarray, "vertices 3"], sweeps: int
    ) -> Float[np.ndarray, "vertices 3"]:
        """Return the positions with edge lengths restored, no deeper in the table than before."""
        kept = positions
        if sweeps:
            kept = self._cloth.keep_lengths(kept, self._free * self._mobility, sweeps)
        if self._table is not None:
            inside = np.maximum(self._lowest - _heights(kept, self._table), 0.0)
            kept = kept + inside[:, None] * self._table.normal
        # Round moved vertices to single precision, so that the count holds in any precision.
        return np.where(self._free[:, None], kept.astype(np.float32), positions)

    def _straighten(self, fewest: int) -> None:
        """Restore edge lengths further as long as that adds no crossing."""
        for _ in range(_STRAIGHTENING):
            positions = self._kept(self._best, _SWEEPS)
            found = self._search.contours(positions)
            if found.crossing_edges > fewest:
                step_m = _BACK_OUT * self._edge_m
                positions = self._moved(positions, found, step_m, pieces=False, sweeps=0)
                found = self._search.contours(positions)
            if found.crossing_edges > fewest:
                return
            self._best = positions


def _heights(
    positions: Float[np.ndarray, "vertices 3"], table: Table
) -> Float[np.ndarray, " vertices"]:
    return (positions - table.point) @ table.normal


class _Lengths:
    """Passes over the edges of a mesh that has some free vertices."""

    def __init__(self, mesh: ClothMesh, device: str) -> None:
        self._device = device
        self._edges = DeviceConstraints(stretch_constraints(mesh), device)
        clock = kernels.Clock()
        clock.inverse_square = 1.0
        self._clocks = wp.array([clock], dtype=kernels.Clock, device=device)
        self._give = wp.array([_GIVE], dtype=float, device=device)

    def __call__(
        self,
        positions: Float[np.ndarray, "vertices 3"],
        masses: Float[np.ndarray, " vertices"],
        sweeps: int,
    ) -> Float[np.ndarray, "vertices 3"]:
        """Return the positions after some passes with these inverse masses.

        Vertices with inverse mass 0 are unchanged to the bit.
        """
        kept = wp.array(positions[None].astype(np.float32), dtype=wp.vec3, device=self._device)
        given = wp.array(masses[None].astype(np.float32), dtype=float, device=self._device)
        for _ in range(sweeps):
            self._edges.sweep(self._clocks, self._give, given, kept)
        return np.where(masses[:, None] > 0.0, kept.numpy()[0], positions)
