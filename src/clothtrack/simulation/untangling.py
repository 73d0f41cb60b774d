"""Takes a cloth that has passed through itself apart again, whatever it was before.

Contact remembers on which side of each other two layers were, and cannot undo a crossing that it
remembers the wrong way round. Untangling asks for no history: it moves the two sheets of each line
of intersection apart until there is none (`contour_moves`), and after every move a few passes over
the edges give them their lengths back (XPBD, as in the solver).
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
"""Longest move of a vertex in the first and in the last possible round, in median edges.
A fifth of it leaves many times the crossings: what is folded within an edge is not stepped over."""

REACH = 4
"""Edges from a moved vertex within which lengths are kept, and vertices may follow."""

_SWEEPS = 6
"""Passes over the edges after each move."""

_GIVE = 0.2
"""What an edge gives in a pass, against 2 for its two vertices."""

PATIENCE = 10
"""Rounds without fewer crossings before the other way is tried: with small pieces taken back, or by
shortening alone. Two changes without success are the end."""

_STRAIGHTENING = 8
"""Most times that edges are straightened further at the end, while no crossing comes back."""

_BACK_OUT = 0.1
"""Step that takes a crossing back out which straightening made, in median edges."""


@dataclass(frozen=True, eq=False)
class Untangling:
    """What became of a cloth that had passed through itself.

    Attributes:
        positions: of the vertices [m]: those with the fewest crossings of all rounds. Vertices far
            from any crossing have their bits.
        crossings_before: edges that passed through a triangle (`geometry.quality: crossings`).
        crossings_after: edges that still do; more than none says that it failed.
        rounds: moves that were tried.
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
    """Return the cloth with as few passages through itself as can be had.

    Args:
        mesh: the cloth; where its vertices are tells the lengths of its edges.
        positions: where its vertices are [m].
        mobility: how readily each vertex moves, 0 to 1: less where it was seen to be; 1 when None.
        table: no vertex is moved farther into it.
        rounds: most moves.
        device: "cpu" or "cuda:0".

    Returns:
        The positions, and how many crossings there were and are.
    """
    return Untangler(mesh, device=device)(positions, mobility=mobility, table=table, rounds=rounds)


class Untangler:
    """`untangled` of one cloth, as often as wanted; what only a crossing needs waits for one.

    Args:
        mesh: the cloth; where its vertices are tells the lengths of its edges.
        device: "cpu" or "cuda:0".
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
        """Return what `untangled` returns."""
        given = np.asarray(positions)
        ready = np.ones(len(given)) if mobility is None else np.asarray(mobility, np.float64)
        return _Attempt(self, given, ready, table).run(rounds)

    @cached_property
    def moves(self) -> ContourMoves:
        """How vertices move so that contours become shorter."""
        return ContourMoves(self.search)

    @cached_property
    def keep_lengths(self) -> "_Lengths":
        """Passes over the edges."""
        return _Lengths(self._mesh, self._device)

    @cached_property
    def joined(self) -> sparse.csr_array:
        """Which vertices an edge joins."""
        i, j = self._mesh.edges.T
        ends = np.concatenate([i, j]), np.concatenate([j, i])
        ones = np.ones(2 * len(i), np.int8)
        return sparse.coo_array((ones, ends), (self._mesh.vertex_count,) * 2).tocsr()


class _Attempt:
    """One untangling: what was found best, and how it goes on."""

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
        """Move until nothing crosses, nothing helps, or the rounds are used up."""
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
        # A zero added to a negative zero would change its bits.
        return self._kept(np.where(self._free[:, None], positions + move, positions), sweeps)

    def _kept(
        self, positions: Float[np.ndarray, "vertices 3"], sweeps: int
    ) -> Float[np.ndarray, "vertices 3"]:
        """The positions with edges straightened, and nothing farther in the table than it was."""
        kept = positions
        if sweeps:
            kept = self._cloth.keep_lengths(kept, self._free * self._mobility, sweeps)
        if self._table is not None:
            inside = np.maximum(self._lowest - _heights(kept, self._table), 0.0)
            kept = kept + inside[:, None] * self._table.normal
        # Single precision for what moves, so that the count is that of the result in any precision.
        return np.where(self._free[:, None], kept.astype(np.float32), positions)

    def _straighten(self, fewest: int) -> None:
        """Give edges more of their lengths back while that makes no crossing."""
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
    """Passes over the edges of a mesh, some of whose vertices are free."""

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

        Those of 0 keep their bits.
        """
        kept = wp.array(positions[None].astype(np.float32), dtype=wp.vec3, device=self._device)
        given = wp.array(masses[None].astype(np.float32), dtype=float, device=self._device)
        for _ in range(sweeps):
            self._edges.sweep(self._clocks, self._give, given, kept)
        return np.where(masses[:, None] > 0.0, kept.numpy()[0], positions)
