"""Dynamics that predict the result of a pick-and-place, and the simulator as one of them.

The solver rolls out all candidates at once, one environment each. The learned dynamics
(`clothtrack_lab/graph_dynamics/mesh_dynamics.py`) implement the same protocol.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from clothtrack.files.bounds import Checked, Positive
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.planning.action_space import PickPlace
from clothtrack.planning.coarse_cloth import CoarseConfig
from clothtrack.recordings.recording import Table
from clothtrack.simulation.parameters import ClothParameters, SolverConfig
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import Attachment, ClothState

REACH = 1.5
"""A pick more than this many edge lengths from every vertex holds nothing."""

_FINE_REACH_M = 0.01
"""Horizontal distance from the pick within which fine vertices lie under the fingers [m]."""

COLUMN = 0.75
"""Horizontal distance from a pick [edge lengths] within which the topmost vertex is held."""


@dataclass(frozen=True, eq=False)
class PlannedCloth:
    """Cloth state used in planning.

    Attributes:
        flat: the garment at rest; its edges are the rest lengths [m].
        positions: current vertex positions [m], world frame, z up.
        table_height_m: height of the table in the world [m].
        fine: vertices of the fine cloth that this one coarsens [m], which show more exactly which
            layer is on top; None: there is none.
        stands_for: for each vertex of the fine cloth, the nearest vertex of this one in the flat
            garment.
    """

    flat: ClothMesh
    positions: Float[np.ndarray, "vertices 3"]
    table_height_m: float = 0.0
    fine: Float[np.ndarray, "fine_vertices 3"] | None = None
    stands_for: Int[np.ndarray, " fine_vertices"] | None = None


@dataclass(frozen=True)
class LearnedDynamics:
    """Dynamics of another package, registered as an entry point of `clothtrack.dynamics`.

    Attributes:
        load: function that loads them from a weights file, on a device.
        extra: extra that the package needs besides tracking, such as "learn".
    """

    load: "Callable[..., PlanningDynamics]"
    shipped: Path
    extra: str


@runtime_checkable
class PlanningDynamics(Protocol):
    """Predictor of the cloth after an action; the planner's only physics model."""

    @property
    def coarse(self) -> CoarseConfig:
        """Settings of the coarse mesh that is rolled out."""
        ...

    def predict(
        self, cloth: PlannedCloth, actions: Sequence[PickPlace | None]
    ) -> Float[np.ndarray, "actions vertices 3"]:
        """Return the vertices [m] at rest after each action, each started from the same cloth.

        None means no action. Vertices of a diverged cloth are not finite.
        """
        ...


@dataclass(frozen=True)
class MotionConfig(Checked):
    """Execution of a planned action in the dynamics.

    Attributes:
        speed: highest speed of the tip [m/s]; above the robot's because nothing swings here.
        time_step_s: time between two points of the tip's path [s].
        rest_s: time from the last release until the cloth is evaluated [s].
    """

    speed: Positive = 0.5
    time_step_s: Positive = 0.025
    rest_s: float = 0.3


def held_vertex(cloth: PlannedCloth, action: PickPlace) -> int | None:
    """Return the vertex that a gripper grasps at the pick; None if no cloth is there.

    The result is the topmost vertex under the pick, or the nearest if none is directly under it.
    If a fine cloth is given, its topmost point selects the layer. With the coarse vertices alone,
    10 of 100 candidates on a crumpled shirt grasped another layer, and a towel's best candidate
    held a point 30 cm away in the cloth.
    """
    if cloth.fine is not None and cloth.stands_for is not None:
        gap = np.linalg.norm(cloth.fine[:, :2] - action.pick[:2], axis=1)
        under = np.flatnonzero(gap <= _FINE_REACH_M)
        if len(under):
            return int(cloth.stands_for[under[np.argmax(cloth.fine[under, 2])]])
    spacing = float(np.median(cloth.flat.edge_lengths))
    gap = np.linalg.norm(cloth.positions[:, :2] - action.pick[:2], axis=1)
    nearest = int(np.argmin(gap))
    if gap[nearest] > REACH * spacing:
        return None
    under = np.flatnonzero(gap <= max(COLUMN * spacing, float(gap[nearest])))
    return int(under[np.argmax(cloth.positions[under, 2])])


@dataclass(frozen=True, eq=False)
class HeldPaths:
    """Held vertex of each candidate, and its path.

    Attributes:
        vertices: held vertex per candidate; -1 holds nothing.
        targets: its position [m] after each time step; constant after the release.
    """

    vertices: np.ndarray
    targets: Float[np.ndarray, "candidates steps 3"]
    steps: np.ndarray

    @classmethod
    def of(
        cls, cloth: PlannedCloth, actions: Sequence[PickPlace | None], motion: MotionConfig
    ) -> "HeldPaths":
        """Return the held vertices' paths, with a constant offset to the tip."""
        held = [None if action is None else held_vertex(cloth, action) for action in actions]
        paths = [
            np.zeros((0, 3)) if action is None or vertex is None
            else action.path(motion.speed, motion.time_step_s)
            + cloth.positions[vertex] - action.pick
            for action, vertex in zip(actions, held, strict=True)
        ]  # fmt: skip
        steps = np.array([len(path) for path in paths], dtype=np.int64)
        targets = np.zeros((len(actions), int(steps.max(initial=0)), 3))
        for index, path in enumerate(paths):
            if len(path):
                targets[index, : len(path)] = path
                targets[index, len(path) :] = path[-1]
        vertices = np.array([-1 if vertex is None else vertex for vertex in held], dtype=np.int64)
        return cls(vertices, targets, steps)

    def batches(self, size: int) -> list[Int[np.ndarray, " chosen"]]:
        """Return candidates in batches of about this size, sorted by duration.

        Long paths take four times as long as short ones; sorting keeps short ones from waiting.
        """
        lasts = np.where(self.vertices < 0, np.median(self.steps), self.steps)
        order = np.argsort(lasts, kind="stable")
        return np.array_split(order, math.ceil(len(order) / size))

    def of_candidates(self, chosen: Int[np.ndarray, " chosen"]) -> "HeldPaths":
        """Return the paths of some candidates, cut to the longest of them."""
        steps = self.steps[chosen]
        return HeldPaths(
            self.vertices[chosen], self.targets[chosen, : int(steps.max(initial=0))], steps
        )


PLANNING_SOLVER = SolverConfig(
    edge_contact=False,
    substep_s=2.5e-3,
    contact_margin_m=0.004,
    contact_depth_m=0.01,
    speed_limit=2.0,
    damping=4.0,
    bend_limit=0.1,
    rebuild_s=0.025,
    buckling=20.0,
)
"""Solver settings for a coarse cloth: no edge contact, long substeps, and sharp folds.

If a bend pair resisted at half its rest length, every fold of such long edges would spring open:
with 0.55 a folded corner moved by 8 cm on its own, with 0.1 by 3 cm. If edges resisted compression
like tension, cloth crumpled between their ends would unfold: with `buckling` the cloth ends 24
instead of 30 mm from the right place (docs/flattening.md). Contacts are searched every 25 ms, which
takes 0.6 of the time of 10 ms and ranks actions equally well.
"""

_TOGETHER = 26
"""Approximate batch size of the simulator. Candidates of similar duration share a batch, because a
batch takes as long as its longest candidate."""


@dataclass(frozen=True)
class SimulatorConfig(Checked):
    """Settings of the solver as the dynamics of a planner.

    Attributes:
        coarse: settings of the mesh that is rolled out.
        motion: execution of actions.
        parameters: material parameters of the cloth.
    """

    coarse: CoarseConfig = field(default_factory=CoarseConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    parameters: ClothParameters = field(
        default_factory=lambda: ClothParameters(stretch_compliance=3e-3)
    )


class SimulatorDynamics:
    """The cloth solver as dynamics; every candidate is one environment.

    Solvers for the most recent mesh are cached so that a decision allocates nothing.
    """

    def __init__(
        self,
        config: SimulatorConfig | None = None,
        *,
        solver: SolverConfig = PLANNING_SOLVER,
        together: int = _TOGETHER,
        device: str = "cpu",
    ) -> None:
        """Set the configuration; the cloth defines the solver's table."""
        self.config = config or SimulatorConfig()
        self.coarse = self.config.coarse
        self._settings, self._together = solver, together
        self._device = device
        self._mesh: ClothMesh | None = None
        self._table_height_m = 0.0
        self._solvers: dict[int, tuple[ClothSolver, ClothState]] = {}

    def predict(
        self, cloth: PlannedCloth, actions: Sequence[PickPlace | None]
    ) -> Float[np.ndarray, "actions vertices 3"]:
        """Return the vertices [m] at rest after each action."""
        if not actions:
            return np.zeros((0, cloth.flat.vertex_count, 3))
        start = self._start(cloth)
        rested = replace(cloth, positions=start.positions[0].astype(np.float64))
        held = HeldPaths.of(rested, actions, self.config.motion)
        ends = np.zeros((len(actions), cloth.flat.vertex_count, 3))
        for group in held.batches(self._together):
            ends[group] = self._rolled(cloth, start, held.of_candidates(group))
        return ends

    def _rolled(self, cloth: PlannedCloth, start: ClothState, held: HeldPaths) -> np.ndarray:
        """Roll out some of the candidates, one environment each."""
        motion, candidates = self.config.motion, len(held.vertices)
        solver, _ = self._solver(cloth, candidates)
        solver.restore(start)
        every = np.arange(candidates)
        targets = np.zeros((candidates, cloth.flat.vertex_count, 3))
        strength = np.zeros(targets.shape[:2])
        for step in range(held.targets.shape[1]):
            strength[every, held.vertices] = step < held.steps
            targets[every, held.vertices] = held.targets[:, step]
            solver.step(motion.time_step_s, Attachment(targets, strength))
        for _ in range(math.ceil(motion.rest_s / motion.time_step_s)):
            solver.step(motion.time_step_s)
        return solver.positions.astype(np.float64)

    def _start(self, cloth: PlannedCloth) -> ClothState:
        """Return the common start state of all candidates, with the cloth on the table."""
        solver, fresh = self._solver(cloth, 1)
        solver.restore(fresh)
        placed = np.array(cloth.positions, dtype=np.float64)
        low = cloth.table_height_m + self._settings.resting_height_m
        placed[:, 2] = np.maximum(placed[:, 2], low)
        solver.place(placed)
        solver.set_velocities(np.zeros_like(placed))
        return solver.save()

    def _solver(self, cloth: PlannedCloth, environments: int) -> tuple[ClothSolver, ClothState]:
        """Return a solver for this many environments, and its state with the cloth flat."""
        if cloth.flat is not self._mesh or cloth.table_height_m != self._table_height_m:
            self._mesh, self._table_height_m = cloth.flat, cloth.table_height_m
            self._solvers.clear()
        if environments not in self._solvers:
            height = cloth.table_height_m
            table = Table(np.array([0.0, 0.0, height]), np.array([0.0, 0.0, 1.0]))
            config = replace(self._settings, table=table)
            laid = cloth.flat.vertices.astype(np.float64)
            laid[:, 2] += height + config.resting_height_m - laid[:, 2].min()
            solver = ClothSolver(
                cloth.flat.with_vertices(laid),
                config,
                parameters=self.config.parameters,
                environments=environments,
                device=self._device,
            )
            # Step once while flat: contact stores which side of each triangle every vertex is on.
            solver.step(self.config.motion.time_step_s)
            self._solvers[environments] = solver, solver.save()
        return self._solvers[environments]
