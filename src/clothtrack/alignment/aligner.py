"""Test-time optimization: compute a small correction of every vertex that fits the mesh to a cloud.

This is the paper's TTO1 (before the pseudo-action, Eq. 1 and 2) and TTO2 (after the last frame).
It computes a displacement per vertex, starting at zero. The displacement minimizes the mean squared
distance of the cloud to the visible vertices plus a rigidity term that moves hidden vertices along.
Two terms are ours: the distance of visible vertices to the cloud, and the deviation of edges from
the rest lengths of the first mesh.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import warp as wp
from jaxtyping import Bool, Float

from clothtrack.alignment.nearest import Matcher
from clothtrack.alignment.solvers import Adam, GaussNewton, Problem, load_kernels
from clothtrack.alignment.terms_kernels import (
    TERMS,
    TWO_WAY_RANGE_M,
    Scene,
    Sizes,
    TermWeights,
)
from clothtrack.files.bounds import Count, NotNegative, Share
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.recording import Table

__all__ = ["Alignment", "AlignmentConfig", "CloudAligner", "Marks"]


@dataclass(frozen=True)
class AlignmentConfig(TermWeights):
    """Objective with the weights of `TermWeights`, and settings of its minimization.

    Attributes:
        solver: "adam" is `Adam`, as in the paper; "icp" is `GaussNewton`.
        iterations: maximum iterations of the solver.
        icp_inner: `GaussNewton.inner`.
        icp_momentum: `GaussNewton.momentum`.
        icp_damping: `GaussNewton.damping`.
        icp_tolerance: `GaussNewton.tolerance`.
    """

    solver: Literal["adam", "icp"] = "adam"
    iterations: Count = 200
    icp_inner: Count = 12
    icp_momentum: float = 0.8
    icp_damping: NotNegative = 0.2
    icp_tolerance: Share = 0.0

    @property
    def minimizer(self) -> Adam | GaussNewton:
        """The solver with its settings."""
        if self.solver == "adam":
            return Adam(self.iterations)
        return GaussNewton(
            self.iterations, self.icp_inner, self.icp_momentum, self.icp_damping, self.icp_tolerance
        )


@dataclass(frozen=True, eq=False)
class Marks:
    """Vertex targets given by points that are followed in the pictures.

    Attributes:
        wanted: targets [m], world frame; ignored if the weight is 0.
        weight: number of followed points that contribute to each target.
    """

    wanted: Float[np.ndarray, "vertices 3"]
    weight: Float[np.ndarray, " vertices"]


@dataclass(frozen=True, eq=False)
class Alignment:
    """Result of an alignment.

    Attributes:
        corrections: displacement of every vertex [m], world frame.
        losses: objective [m^2] at the start and after every iteration.
        terms: the same per weighted term, by the names of `TERMS`.
        reason: why it ended: "iterations": all were done; "tolerance": converged before; or "no
            points", "no visible vertex" or "not finite", with zero corrections.
    """

    corrections: Float[np.ndarray, "vertices 3"]
    losses: Float[np.ndarray, " evaluations"]
    terms: Mapping[str, Float[np.ndarray, " evaluations"]]
    iterations: int
    reason: str


class CloudAligner:
    """Aligner of one cloth to clouds; topology and rest lengths are prepared once.

    Args:
        mesh: the flat first mesh; its edges give the pairs of the rigidity and the rest lengths.
    """

    def __init__(self, mesh: ClothMesh, config: AlignmentConfig, *, device: str = "cpu") -> None:
        self._config, self._device = config, device
        load_kernels(device)
        self._solver = config.minimizer
        self._vertices, self._edges = mesh.vertex_count, len(mesh.edges)
        self._spacing_m = float(mesh.edge_lengths.mean())
        ends = np.concatenate([mesh.edges, mesh.edges[:, ::-1]])
        lengths = np.concatenate([mesh.edge_lengths, mesh.edge_lengths])
        order = np.lexsort((ends[:, 1], ends[:, 0]))
        first = np.searchsorted(ends[order, 0], np.arange(self._vertices + 1))
        self._first = self._array(first, wp.int32)
        self._neighbor = self._array(ends[order, 1], wp.int32)
        self._rest_length = self._array(lengths[order], wp.float32)

    def align(
        self,
        positions: Float[np.ndarray, "vertices 3"],
        observation_points: Float[np.ndarray, "points 3"],
        visible: Bool[np.ndarray, " vertices"],
        *,
        trusted: Bool[np.ndarray, " vertices"] | None = None,
        table: Table | None = None,
        rest_height_m: float = 0.0,
        marks: Marks | None = None,
    ) -> Alignment:
        """Compute corrections of the vertices toward the cloud.

        Args:
            positions: the predicted mesh [m], world frame.
            observation_points: the cloud [m], world frame.
            rest_height_m: height of a vertex that lies on the table [m].
        """
        if not len(observation_points) or not visible.any():
            reason = "no visible vertex" if len(observation_points) else "no points"
            return self._nothing(reason)
        if not (np.isfinite(positions).all() and np.isfinite(observation_points).all()):
            return self._nothing("not finite")
        problem = self._problem(
            positions, observation_points, visible, trusted,
            table=table, rest_height_m=rest_height_m, marks=marks,
        )  # fmt: skip
        corrections, sums = self._solver.solve(problem)
        if not np.isfinite(corrections).all():
            return self._nothing("not finite")
        terms = problem.terms(sums)
        return Alignment(
            corrections=corrections,
            losses=np.sum(list(terms.values()), axis=0),
            terms=terms,
            iterations=len(sums) - 1,
            reason="iterations" if len(sums) > self._solver.iterations else "tolerance",
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
        marks: Marks | None = None,
    ) -> tuple[float, Float[np.ndarray, "vertices 3"]]:
        """Return the objective [m^2] and its gradient [m] at a displacement [m], at fixed matches.

        The arguments are those of `align`; the matches are computed at the displaced vertices.
        """
        problem = self._problem(
            positions, observation_points, visible, trusted,
            table=table, rest_height_m=rest_height_m, marks=marks,
        )  # fmt: skip
        displaced = self._array(displacements.astype(np.float32), wp.vec3)
        moved = self._array(problem.initial.numpy() + displaced.numpy(), wp.vec3)
        problem.matcher.rebuild(moved)
        sums = problem.sums(1)
        gradient = problem.measure(moved, displaced, sums)
        terms = problem.terms(sums.numpy())
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
        *,
        table: Table | None,
        rest_height_m: float,
        marks: Marks | None,
    ) -> Problem:
        config = self._config
        trusted = visible if trusted is None else trusted & visible
        if config.two_way_weight == 0:
            trusted = np.zeros_like(visible)
        if config.marks_weight == 0.0:
            marks = None
        # Center the data: single precision resolves micrometers only near the origin.
        center = positions.mean(axis=0, dtype=np.float64)
        initial = self._array((positions - center).astype(np.float32), wp.vec3)
        cloud = self._array((points - center).astype(np.float32), wp.vec3)
        matcher = Matcher(
            cloud, initial, visible, trusted, spacing_m=self._spacing_m, range_m=TWO_WAY_RANGE_M
        )
        scene = Scene()
        scene.first, scene.neighbor = self._first, self._neighbor
        scene.rest_length, scene.cloud = self._rest_length, cloud
        scene.pulled_count, scene.pulled_sum = matcher.pulled_count, matcher.pulled_sum
        scene.partner, scene.partner_count = matcher.partner, matcher.progress.partners
        mark, mark_weight = np.zeros((self._vertices, 3)), np.zeros(self._vertices)
        if marks is not None:
            mark = np.where(marks.weight[:, None] > 0.0, marks.wanted - center, 0.0)
            mark_weight = marks.weight
        scene.mark = self._array(mark.astype(np.float32), wp.vec3)
        scene.mark_weight = self._array(mark_weight.astype(np.float32), wp.float32)
        scene.lowest = -1e6
        if table is not None:
            scene.table_normal = wp.vec3(*np.asarray(table.normal, float).tolist())
            scene.lowest = rest_height_m + float((table.point - center) @ table.normal)
        sizes = Sizes(
            len(points), self._vertices, self._edges, marks is not None, table is not None
        )
        scales = tuple(float(term.weight(config, sizes)) for term in TERMS)
        return Problem(initial, matcher, scene, scales)
