"""Test-time optimisation: the small correction of every vertex that explains the cloud.

This is the paper's TTO1 (before the pseudo-action, Eq. 1 and 2) and TTO2 (after the last frame):
a displacement per vertex, starting at zero, that minimises the mean squared distance of the cloud
to the visible vertices plus a rigidity that carries hidden vertices along. Two terms are ours:
visible vertices look for the cloud as well, and edges keep the rest length of the first mesh.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import warp as wp
from jaxtyping import Bool, Float

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Table
from clothtrack.tracking import alignment_kernels as kernels
from clothtrack.tracking.nearest import Matcher

_REBUILD_AT = frozenset((2, 4, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768))


@dataclass(frozen=True)
class AlignmentConfig:
    """The objective and how it is minimised. Every term is a mean of squares [m^2].

    Attributes:
        solver: "adam" follows the paper; "icp" (fixed matches, Gauss-Newton, conjugate gradients)
            is several times faster and ends a few percent higher.
        iterations: steps of Adam (the paper: 200).
        step_m: step of Adam [m].
        chamfer_weight: cloud point to nearest visible vertex (the paper: 1).
        rigidity_weight: difference of the displacements along edges (the paper: 10).
        two_way_weight: trusted visible vertex to nearest cloud point; 0 is the paper.
        two_way_range_m: only vertices whose nearest cloud point is that far away count [m]: nearer
            is the cloud's spacing, farther is what the camera missed.
        length_weight: stretch of edges against the first mesh; 0 is the paper.
        table_weight: depth under the resting height (the reference implementation: 10).
        vertical_weight: factor of the vertical part of squared residuals against the cloud; below
            1 while the thickness of the layers is not known.
        neighbours_every: renew the neighbours every so many iterations.
        icp_outer: how often the icp solver renews matches and linearisation.
        icp_inner: conjugate gradient steps in between.
        icp_momentum: part of the last outer step that is added to the next.
    """

    solver: Literal["adam", "icp"] = "adam"
    iterations: int = 200
    step_m: float = 1e-3
    chamfer_weight: float = 1.0
    rigidity_weight: float = 10.0
    two_way_weight: float = 1.0
    two_way_range_m: tuple[float, float] = (0.004, 0.08)
    length_weight: float = 300.0
    table_weight: float = 10.0
    vertical_weight: float = 1.0
    neighbours_every: int = 1
    icp_outer: int = 8
    icp_inner: int = 12
    icp_momentum: float = 0.8

    def __post_init__(self) -> None:
        """Refuse values that cannot be meant.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        if self.solver not in ("adam", "icp"):
            raise InvalidConfigError(f"alignment solver is {self.solver!r}; use 'adam' or 'icp'")
        for name in ("iterations", "neighbours_every", "icp_outer", "icp_inner"):
            if getattr(self, name) < 1:
                raise InvalidConfigError(f"{name} is {getattr(self, name)}; it must be at least 1")
        for name in ("chamfer", "rigidity", "two_way", "length", "table", "vertical"):
            value = getattr(self, f"{name}_weight")
            if not (np.isfinite(value) and value >= 0):
                raise InvalidConfigError(f"{name}_weight is {value}; it must be 0 or more")
        if not self.step_m > 0:
            raise InvalidConfigError(f"step_m is {self.step_m}; it must be positive [m]")
        low, high = self.two_way_range_m
        if not 0 <= low < high < np.inf:
            raise InvalidConfigError(
                f"two_way_range_m is {self.two_way_range_m}; it must be (low, high) in metres with "
                "0 <= low < high"
            )


@dataclass(frozen=True, eq=False)
class Alignment:
    """What an alignment found.

    Attributes:
        corrections: displacement of every vertex [m], world frame.
        losses: objective [m^2] at the start and after every iteration.
        terms: the same per weighted term: "chamfer", "rigidity", "two_way", "length", "table".
        iterations: iterations done (outer ones for the icp solver).
        reason: why it ended: "iterations", or "no points", "no visible vertex" or "not finite",
            in which cases the corrections are zero.
    """

    corrections: Float[np.ndarray, "vertices 3"]
    losses: Float[np.ndarray, " evaluations"]
    terms: Mapping[str, Float[np.ndarray, " evaluations"]]
    iterations: int
    reason: str


class Aligner:
    """Aligns one cloth to clouds; topology and rest lengths are prepared once.

    Args:
        mesh: the flat first mesh; its edges give the rigidity's pairs and the rest lengths.
        config: objective and solver.
        device: Warp device, "cpu" or "cuda:0".
    """

    def __init__(self, mesh: ClothMesh, config: AlignmentConfig, *, device: str = "cpu") -> None:
        self._config, self._device = config, device
        self._vertices, self._edges = mesh.vertex_count, len(mesh.edges)
        self._spacing_m = float(mesh.edge_lengths.mean())
        ends = np.concatenate([mesh.edges, mesh.edges[:, ::-1]])
        lengths = np.concatenate([mesh.edge_lengths, mesh.edge_lengths])
        order = np.lexsort((ends[:, 1], ends[:, 0]))
        first = np.searchsorted(ends[order, 0], np.arange(self._vertices + 1))
        self._topology = kernels.Topology()
        self._topology.first = self._array(first, wp.int32)
        self._topology.neighbour = self._array(ends[order, 1], wp.int32)
        self._topology.rest_length = self._array(lengths[order], wp.float32)

    def align(
        self,
        positions: Float[np.ndarray, "vertices 3"],
        observation_points: Float[np.ndarray, "points 3"],
        visible: Bool[np.ndarray, " vertices"],
        *,
        trusted: Bool[np.ndarray, " vertices"] | None = None,
        table: Table | None = None,
        rest_height_m: float = 0.0,
    ) -> Alignment:
        """Correct the vertices towards the cloud.

        Args:
            positions: the mesh as predicted [m], world frame.
            observation_points: the cloud [m], world frame.
            visible: vertices that a cloud point can belong to.
            trusted: visible vertices whose absence from the cloud means something: only they look
                for a cloud point themselves. All visible ones when None.
            table: the plane that the cloth cannot pass, or None.
            rest_height_m: height of a vertex that lies on the table [m].

        Returns:
            The corrections and how the objective fell; zero corrections, with the reason, when
            there is nothing to align or the numbers ran away.
        """
        if not len(observation_points) or not visible.any():
            reason = "no visible vertex" if len(observation_points) else "no points"
            return self._nothing(reason)
        if not (np.isfinite(positions).all() and np.isfinite(observation_points).all()):
            return self._nothing("not finite")
        problem = self._problem(positions, observation_points, visible, trusted)
        problem.weights = self._weights(problem, table, rest_height_m)
        solve = _solve_adam if self._config.solver == "adam" else _solve_icp
        corrections, sums = solve(problem, self._config)
        if not np.isfinite(corrections).all():
            return self._nothing("not finite")
        terms = self._terms(sums, len(observation_points))
        return Alignment(
            corrections=corrections,
            losses=np.sum(list(terms.values()), axis=0),
            terms=terms,
            iterations=len(sums) - 1,
            reason="iterations",
        )

    def gradient(
        self,
        positions: Float[np.ndarray, "vertices 3"],
        displacements: Float[np.ndarray, "vertices 3"],
        observation_points: Float[np.ndarray, "points 3"],
        visible: Bool[np.ndarray, " vertices"],
        *,
        trusted: Bool[np.ndarray, " vertices"] | None = None,
        table: Table | None = None,
        rest_height_m: float = 0.0,
    ) -> tuple[float, Float[np.ndarray, "vertices 3"]]:
        """The objective [m^2] and its gradient [m] at a displacement [m], matches held fixed.

        The arguments are those of `align`; the matches are the ones at the displaced vertices.
        """
        problem = self._problem(positions, observation_points, visible, trusted)
        problem.weights = self._weights(problem, table, rest_height_m)
        displaced = self._array(displacements.astype(np.float32), wp.vec3)
        moved = self._array(problem.initial.numpy() + displaced.numpy(), wp.vec3)
        problem.matcher.rebuild(moved)
        sums = problem.sums(1)
        gradient = problem.measure(moved, displaced, sums)
        terms = self._terms(sums.numpy(), problem.point_count)
        return float(sum(term[0] for term in terms.values())), gradient.numpy()

    def _array(self, values: np.ndarray, dtype: type) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self._device)

    def _nothing(self, reason: str) -> Alignment:
        return Alignment(
            np.zeros((self._vertices, 3), np.float32), np.full(1, np.nan), {}, 0, reason
        )

    def _problem(
        self,
        positions: np.ndarray,
        points: np.ndarray,
        visible: np.ndarray,
        trusted: np.ndarray | None,
    ) -> "_Problem":
        trusted = visible if trusted is None else trusted & visible
        if self._config.two_way_weight == 0:
            trusted = np.zeros_like(visible)
        # Single precision keeps micrometres only near the origin.
        centre = positions.mean(axis=0, dtype=np.float64)
        config = self._config
        initial = self._array((positions - centre).astype(np.float32), wp.vec3)
        cloud = self._array((points - centre).astype(np.float32), wp.vec3)
        matcher = Matcher(
            cloud, initial, visible, trusted,
            spacing_m=self._spacing_m, every=config.neighbours_every,
            vertical_weight=config.vertical_weight, range_m=config.two_way_range_m,
        )  # fmt: skip
        matches = kernels.Matches()
        matches.cloud, matches.partner = cloud, matcher.partner
        matches.pulled_count, matches.pulled_sum = matcher.pulled_count, matcher.pulled_sum
        return _Problem(centre, initial, matcher, matches, self._topology, len(points))

    def _weights(self, problem: "_Problem", table: Table | None, rest_height_m: float) -> object:
        config = self._config
        weights = kernels.Weights()
        weights.data = config.chamfer_weight / problem.point_count
        weights.vertical = config.vertical_weight
        weights.rigidity = config.rigidity_weight / self._edges
        weights.length = config.length_weight / self._edges
        weights.two_way = config.two_way_weight
        weights.lowest = -1e6
        if table is not None:
            weights.table = config.table_weight / self._vertices
            weights.table_normal = wp.vec3(*np.asarray(table.normal, float).tolist())
            weights.lowest = rest_height_m + float((table.point - problem.centre) @ table.normal)
        return weights

    def _terms(self, sums: np.ndarray, points: int) -> dict[str, np.ndarray]:
        config = self._config
        partners = np.maximum(sums[:, kernels.PARTNERS], 1)
        squares = sums[:, : kernels.PARTNERS] / kernels.FIXED_POINT_SQUARE
        return {
            "chamfer": config.chamfer_weight / points * squares[:, kernels.DATA],
            "rigidity": config.rigidity_weight / self._edges * squares[:, kernels.RIGIDITY],
            "two_way": config.two_way_weight / partners * squares[:, kernels.TWO_WAY],
            "length": config.length_weight / self._edges * squares[:, kernels.LENGTH],
            "table": config.table_weight / self._vertices * squares[:, kernels.TABLE],
        }


@dataclass(eq=False)
class _Problem:
    """One alignment on the device."""

    centre: np.ndarray
    initial: wp.array
    matcher: Matcher
    matches: object
    topology: object
    point_count: int
    weights: object = None

    def vectors(self) -> wp.array:
        """A vector per vertex, zero."""
        return wp.zeros(len(self.initial), dtype=wp.vec3, device=self.initial.device)

    def sums(self, rows: int) -> wp.array:
        """Room for the sums of so many evaluations."""
        return wp.zeros((rows, 6), dtype=wp.int64, device=self.initial.device)

    @property
    def objective(self) -> list[object]:
        """What every kernel that looks at the objective takes first."""
        return [self.topology, self.matches, self.weights, self.matcher.progress]

    def measure(self, positions: wp.array, displacements: wp.array, sums: wp.array) -> wp.array:
        """Match and record the objective; its gradient [m^2 per m]."""
        self.matcher.launch(positions, sums)
        gradient = self.vectors()
        wp.launch(
            kernels.measure,
            dim=len(positions),
            inputs=[*self.objective, positions, displacements, sums, gradient],
            device=positions.device,
        )
        return gradient


def _captured(work: Callable[[], None], device: wp.Device) -> Callable[[], None]:
    """Record launches as a graph, so that repeating them costs next to nothing in Python."""
    with wp.ScopedCapture(device=device) as capture:
        work()
    return lambda: wp.capture_launch(capture.graph)


def _solve_adam(problem: _Problem, config: AlignmentConfig) -> tuple[np.ndarray, np.ndarray]:
    """Adam with matches renewed in every iteration: displacement [m] and sums per evaluation."""
    initial, matcher = problem.initial, problem.matcher
    moments = problem.vectors(), problem.vectors()
    strip = 64 if wp.get_device(initial.device).is_cpu else 1
    sums = problem.sums(config.iterations + 1)
    here = wp.clone(initial), problem.vectors()
    there = wp.clone(initial), problem.vectors()

    def iterate(source: tuple[wp.array, wp.array], target: tuple[wp.array, wp.array]) -> None:
        matcher.launch(source[0], sums)
        wp.launch(
            kernels.step_adam,
            dim=-(-len(initial) // strip),
            inputs=[
                *problem.objective, config.step_m, matcher.searched, matcher.grid.recorded,
                initial, *source, sums, *moments, *target, strip,
            ],
            device=initial.device,
        )  # fmt: skip

    def iterate_twice() -> None:
        iterate(here, there)
        iterate(there, here)

    # Kernels must be loaded before a capture; the first two iterations do that.
    repeat = None
    for iteration in range(0, config.iterations - 1, 2):
        if iteration in _REBUILD_AT:
            matcher.rebuild(here[0])
        if repeat is None:
            iterate_twice()
            repeat = _captured(iterate_twice, initial.device)
        else:
            repeat()
    if config.iterations % 2:
        iterate(here, there)
        here = there
    problem.measure(*here, sums)
    return here[1].numpy(), sums.numpy()


def _solve_icp(problem: _Problem, config: AlignmentConfig) -> tuple[np.ndarray, np.ndarray]:
    """Matches fixed, stretch linearised, conjugate gradients; then again."""
    initial, matcher = problem.initial, problem.matcher
    device = initial.device
    positions, displacements = wp.clone(initial), problem.vectors()
    sums = problem.sums(config.icp_outer + 1)
    conjugate, strips = _conjugate(problem)
    solved = problem.vectors()

    def descend() -> None:
        inputs = [problem.topology, problem.weights, conjugate]
        wp.launch(kernels.multiply, dim=strips, inputs=inputs, device=device)
        wp.launch(kernels.descend, dim=strips, inputs=[conjugate], device=device)
        wp.launch(kernels.turn, dim=strips, inputs=[conjugate], device=device)

    repeat = None
    for outer in range(config.icp_outer):
        if outer in _REBUILD_AT:
            matcher.rebuild(positions)
        matcher.launch(positions, sums)
        wp.launch(
            kernels.linearise,
            dim=strips,
            inputs=[*problem.objective, positions, displacements, sums, conjugate],
            device=device,
        )
        for step in range(config.icp_inner):
            if repeat is None and step == 1:
                repeat = _captured(descend, device)
            (repeat or descend)()
        last = outer == config.icp_outer - 1
        wp.launch(
            kernels.apply_solution,
            dim=len(initial),
            inputs=[
                problem.weights, matcher.progress, sums, 0.0 if last else config.icp_momentum,
                matcher.searched, matcher.grid.recorded, initial, conjugate,
                solved, positions, displacements,
            ],
            device=device,
        )  # fmt: skip
    problem.measure(positions, displacements, sums)
    return displacements.numpy(), sums.numpy()


def _conjugate(problem: _Problem) -> tuple[object, int]:
    device, vertices = problem.initial.device, len(problem.initial)
    conjugate = kernels.Conjugate()
    # Long strips waste nothing on one core; a GPU needs many threads.
    conjugate.strip = 64 if device is None or device.is_cpu else 8
    strips = -(-vertices // conjugate.strip)
    edges = len(problem.topology.neighbour)
    conjugate.unit = wp.zeros(edges, dtype=wp.vec3, device=device)
    conjugate.below = wp.zeros(vertices, dtype=wp.bool, device=device)
    for name in ("own", "inverse_diagonal", "solution", "residual", "direction", "product"):
        setattr(conjugate, name, problem.vectors())
    for name in ("residual_dots", "new_residual_dots", "curvature_dots"):
        setattr(conjugate, name, wp.zeros(strips, dtype=wp.float64, device=device))
    return conjugate, strips
