"""Crumples a garment on a table: folds, lifts, drops and pushes it, picks it up and places it.

Two recipes are those of the published data generators (MEDOR's `collect_data_bimanual2.py`,
SoftGym's random drop); the others imitate hands and grippers. An episode is a few states of one
garment, each of which starts from the previous one. A state is recorded when the cloth has come to
rest, on the table or in the gripper.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.quality import edge_strain
from clothtrack.reconstruction.data.folding import NEAT, NeatFolds
from clothtrack.reconstruction.data.recipes import (
    ACTION,
    REFERENCE_SIZE_M,
    CrumplingConfig,
    Recipe,
    drawn,
)
from clothtrack.reconstruction.data.wrinkles import wrinkled
from clothtrack.recordings.recording import Table
from clothtrack.simulation.parameters import ClothParameters, SolverConfig
from clothtrack.simulation.pick_and_place import (
    Picks,
    PlannedAction,
    carrying_path,
    plan_action,
)
from clothtrack.simulation.solver import ClothSolver
from clothtrack.simulation.state import Attachment

STEP_S = 0.025
"""Length of a step of the solver while the cloth is moved [s]."""

_SMOOTHED = 0.3
"""Share of soft folds after which a hand smooths the cloth."""

_SMOOTHING_M = 0.02
"""Largest pull of a hand that smooths a flat garment of `REFERENCE_SIZE_M` [m]."""

_HANG_M = (0.03, 0.25)
"""Bounds of the distance of such a hanging garment from the table before it is dropped [m]."""

_HANG_S = 0.1
"""Time that it hangs [s]."""

_LIFT_SPEED = 1.2
"""Speed at which a vertex of such a garment is lifted [m/s]."""

REST_SPEED = 0.1
"""Mean speed over `_WINDOW_STEPS` below which all vertices must be for a cloth at rest [m/s]."""

_PULL_REACH = 0.7
"""Largest distance of a pull's end from where the garment lay flat, over its longer side."""

MOST_LAYERS, MOST_HEIGHT = 4.5, 0.03
"""Number of layers, and height over the garment's size, above which a pressed stack is no longer
folded as a whole, because a fold doubles the layers."""

_AGAIN = 0.6
"""Share of stacks of many layers that have a part folded back; others are unfolded."""

_LOFT = 0.3
"""Largest loft of a crease over the edge length, so that edges into it keep their lengths."""

_LOFT_M = (0.0003, 0.006)
"""Bounds of the additional distance of layers at the creases of a pressed stack [m], log-uniform.
Creases are not flat, because hands press less than an iron."""

SOFTEST = 0.6
"""Least share of its height that a soft fold is pressed to; below, its bulges lose length."""

_DRIFT_M = 0.1
"""Largest sideways motion of a lifted vertex of a garment of `REFERENCE_SIZE_M` [m]."""

_HELD_SHARE = (0.15, 1.15)
"""Bounds of the height that a held vertex is lifted to, over its distance from the farthest vertex
of the flat garment. Above 1 the whole cloth hangs in the air."""

_HELD_BY_CORNER = 0.7
"""Share of held vertices that are extreme points of the outline."""

_HELD_TWICE = 0.35
"""Share of held states in which two vertices are held."""

_PUSH_RADIUS = 0.12
_PUSH_WAY = (0.1, 0.4)
"""Radius of the cloth that a hand presses on, and bounds of the length of its push, both over the
longer side."""

_WINDOW_STEPS = 4
"""Number of solver steps over which motion is measured while waiting for rest."""


@dataclass(frozen=True, eq=False)
class CrumpledState:
    """One state of an episode.

    Attributes:
        positions: final vertices [m].
        speed: mean speed of the fastest vertex in the last tenth of a second [m/s].
        exploded: whether the simulation is invalid, so that the episode ends.
    """

    recipe: Recipe
    positions: Float32[np.ndarray, "vertices 3"]
    speed: float
    exploded: bool


class Crumpler:
    """One garment on a table, and the recipes that crumple it."""

    def __init__(
        self,
        mesh: ClothMesh,
        config: CrumplingConfig,
        solver: SolverConfig,
        *,
        thickness_m: float | None = None,
        device: str = "cpu",
    ) -> None:
        """Prepare the solver; its table is put at z = 0.

        Args:
            thickness_m: distance of the layers of a pressed stack [m]; that of contact when None.
        """
        self.mesh = mesh
        self.config = config
        table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
        self._rest_height_m = solver.resting_height_m
        self._solver = ClothSolver(mesh, replace(solver, table=table), device=device)
        self._fresh = self._solver.save()
        size = float(np.ptp(mesh.vertices[:, :2], axis=0).max())
        self._size_m, self._scale = size, size / REFERENCE_SIZE_M
        self._pull_reach_m = _PULL_REACH * size
        layers = 2 if np.ptp(mesh.vertices[:, 2]) == 0.0 else 4
        self._action = replace(
            ACTION,
            distance_m=self._scaled(ACTION.distance_m),
            lift_m=self._scaled(ACTION.lift_m),
            grasp_radius_m=ACTION.grasp_radius_m * self._scale,
            speed=self._speed(ACTION.speed),
            reach_m=min(ACTION.reach_m * self._scale, 0.65 * size),
            release_height_m=0.002 + layers * solver.thickness_m,
        )
        self._attached: Attachment | None = None
        self._thickness_m = thickness_m or solver.thickness_m
        self._loft_m = 0.0
        self._folds = NeatFolds(mesh, solver.thickness_m)
        self._stack: Float[np.ndarray, "vertices 3"] | None = None

    def episode(
        self, parameters: ClothParameters, rng: np.random.Generator
    ) -> Iterator[CrumpledState]:
        """Iterate over the states of one episode; an exploded one is the last."""
        self._solver.set_parameters(parameters)
        self._lay_down(turned_over=rng.random() < self.config.turned_over)
        recipe = drawn(self.config.shares, rng)
        pressed = recipe in NEAT and rng.random() < self.config.pressed
        if pressed:
            loft_m = float(np.exp(rng.uniform(*np.log(_LOFT_M))))
            self._loft_m = min(loft_m, _LOFT * self._folds.layers.edge_m)
        for _ in range(self.config.states):
            if recipe in NEAT:
                recipe, state = self._folded(recipe, rng, pressed=pressed)
            else:
                getattr(self, f"_{recipe}")(rng)
                state = self._rest(recipe)
            yield self._finished(state, rng)
            if state.exploded:
                return
            recipe = self._next(recipe, rng)

    def _next(self, recipe: Recipe, rng: np.random.Generator) -> Recipe:
        """Choose the next recipe; a stack too thick for another fold may be unfolded first."""
        if recipe == "held":
            return "release"
        following = self.config.after_fold if recipe in NEAT else self.config.next_shares
        if self._stack is None:
            return drawn(self.config.next_shares if recipe == "roll" else following, rng)
        layers = self._folds.layers.most(self._stack)
        if layers > min(MOST_LAYERS, MOST_HEIGHT * self._size_m / self._thickness_m):
            if rng.random() < _AGAIN:
                return "fold_top"
            self._lay_down(turned_over=rng.random() < self.config.turned_over)
            following = self.config.shares
        neat = {name: following.get(name, 0.0) for name in NEAT}
        if recipe == "turn_over":
            neat[recipe] = 0.0
        if any(neat.values()):
            return drawn(neat, rng)
        self._let_go()
        return drawn(following, rng)

    def _let_go(self) -> None:
        """Place a pressed stack in the solver, with its layers at the contact distance."""
        if self._stack is not None:
            self._folds.layers.thickness_m = 2.0 * self._rest_height_m
            self._solver.place(self._folds.layers.pressed(self._stack))
            self._stack = None

    def _lay_down(self, *, turned_over: bool) -> None:
        """Lay the flat garment on the table, at rest."""
        vertices = np.array(self.mesh.vertices)
        if turned_over:
            vertices = vertices * [-1.0, 1.0, -1.0]
        vertices[:, 2] += self._rest_height_m - vertices[:, 2].min()
        self._solver.restore(self._fresh)
        self._solver.place(vertices)
        self._stack = None
        self._folds.layers.lay_flat()
        self._attached = None

    def _scaled(self, bounds: tuple[float, float]) -> tuple[float, float]:
        """Return bounds of a length [m] for a garment of this size."""
        return bounds[0] * self._scale, bounds[1] * self._scale

    def _speed(self, speed: float) -> float:
        """Return a speed [m/s] for a garment of this size."""
        return speed * float(np.sqrt(self._scale))

    # Recipes

    def _flat(self, rng: np.random.Generator) -> None:
        """Pull at one vertex a little, like a hand that smooths the cloth."""
        vertex = int(rng.integers(self.mesh.vertex_count))
        way = _aside(rng.uniform(0.0, _SMOOTHING_M * self._scale), rng)
        self._carry(np.array([vertex]), way * np.linspace(0.0, 1.0, 5)[1:, None])

    def _lift(self, rng: np.random.Generator) -> None:
        """Lift one vertex while part of the cloth stays on the table, and let it go."""
        vertex = int(rng.integers(self.mesh.vertex_count))
        self._raise(vertex, rng.uniform(*self._scaled(self.config.lift_m)), rng)

    def _drop(self, rng: np.random.Generator) -> None:
        """Lift one vertex until the cloth hangs clear of the table, and let it go."""
        vertex = int(rng.integers(self.mesh.vertex_count))
        clear_m = rng.uniform(*self._scaled(_HANG_M))
        self._raise(vertex, self._hanging_m(vertex) + clear_m, rng)

    def _held(self, rng: np.random.Generator) -> None:
        """Lift one vertex, or two, and keep hold, so that the state is recorded in the air."""
        first = self._grasped(rng)
        vertices = [first]
        if rng.random() < _HELD_TWICE:
            vertices.append(self._grasped(rng))
        height_m = rng.uniform(*_HELD_SHARE) * self._hanging_m(first)
        self._attached = self._raise(np.unique(vertices), height_m, rng)

    def _release(self, rng: np.random.Generator) -> None:
        """Let go of the held cloth, which falls while the episode waits for rest."""

    def _folded(
        self, recipe: Recipe, rng: np.random.Generator, *, pressed: bool
    ) -> tuple[Recipe, CrumpledState]:
        """Fold neatly; return the recipe that was actually used, and the state.

        A pressed stack keeps its folded shape. Otherwise, and if it is rolled, the solver lets the
        cloth relax.
        """
        pressed &= recipe != "roll"
        layers = self._folds.layers
        layers.thickness_m = self._thickness_m if pressed else 2.0 * self._rest_height_m
        layers.loft_m = self._loft_m if pressed else 0.0
        points = self._solver.positions[0].astype(np.float64)
        if self._stack is not None:
            points = self._stack
        recipe, points = self._folds.fold(recipe, points, rng)
        if pressed:
            self._stack = points
            strain = edge_strain(self.mesh, points)
            exploded = strain > self.config.folded_strain_limit
            return recipe, CrumpledState(recipe, points.astype(np.float32), 0.0, exploded)
        self._stack = None
        self._solver.place(points)
        if rng.random() < _SMOOTHED:
            self._flat(rng)
        return recipe, self._rest(recipe)

    def _finished(self, state: CrumpledState, rng: np.random.Generator) -> CrumpledState:
        """Press flat and folded states and add fine wrinkles; return other states unchanged.

        Thin cloth is simulated with the thickness that contact needs. If flat, it is pressed to its
        own thickness.
        """
        if state.exploded or (state.recipe not in NEAT and state.recipe != "flat"):
            return state
        points = state.positions.astype(np.float64)
        if self._stack is None:
            share = min(1.0, self._thickness_m / (2.0 * self._rest_height_m))
            soft = rng.uniform(max(share, SOFTEST), 1.0)
            points[:, 2] *= share if state.recipe == "flat" else soft
        if rng.random() < self.config.wrinkled:
            alone = state.recipe == "flat" and not np.ptp(self.mesh.vertices[:, 2])
            points = wrinkled(
                points,
                edge_m=self._folds.layers.edge_m,
                stacked_m=None if alone else self._thickness_m,
                rng=rng,
            )
        return replace(state, positions=points.astype(np.float32))

    def _push(self, rng: np.random.Generator) -> None:
        """Press a hand on the cloth and push it over the table, mostly towards the middle."""
        points = self._solver.positions[0].astype(np.float64)
        start = points[self._grasped(rng)]
        under = np.linalg.norm(points[:, :2] - start[:2], axis=1) < _PUSH_RADIUS * self._size_m
        inwards = np.arctan2(*(points[:, :2].mean(axis=0) - start[:2])[::-1])
        heading = inwards + rng.normal(0.0, 0.5)
        length_m = self._size_m * rng.uniform(*_PUSH_WAY)
        way = length_m * np.array([np.cos(heading), np.sin(heading), 0.0])
        steps = max(2, round(length_m / self._speed(self._action.speed) / STEP_S))
        self._carry(np.flatnonzero(under), way * np.linspace(0.0, 1.0, steps + 1)[1:, None])

    def _grasped(self, rng: np.random.Generator) -> int:
        """Return a vertex that a hand would grasp, mostly an extreme point of the outline."""
        points = self._solver.positions[0]
        if rng.random() >= _HELD_BY_CORNER:
            return int(rng.integers(len(points)))
        angle = rng.uniform(0.0, 2.0 * np.pi)
        return int(np.argmax(points[:, :2] @ np.array([np.cos(angle), np.sin(angle)])))

    def _hanging_m(self, vertex: int) -> float:
        """Return the length of the garment hanging from a vertex [m]."""
        flat = self.mesh.vertices
        return float(np.linalg.norm(flat - flat[vertex], axis=1).max())

    def _raise(
        self, vertices: int | np.ndarray, height_m: float, rng: np.random.Generator
    ) -> Attachment:
        """Lift vertices together, wait a moment, and return the attachment at the end."""
        drift_m = rng.uniform(0.0, _DRIFT_M * self._scale)
        way = _aside(drift_m, rng) + [0.0, 0.0, height_m]
        speed = self._speed(_LIFT_SPEED)
        steps = max(2, round(float(np.linalg.norm(way)) / speed / STEP_S))
        still = np.ones(round(_HANG_S / STEP_S))
        share = np.concatenate([np.linspace(0.0, 1.0, steps + 1)[1:], still])
        return self._carry(np.atleast_1d(vertices), way * share[:, None])

    def _pick_and_place(self, rng: np.random.Generator) -> None:
        """Pick and place with one gripper, or two that move alike."""
        cloth = self.mesh.with_vertices(self._solver.positions[0].astype(np.float64))
        first = self._plan(cloth, rng)
        held = first.held
        if rng.random() < self.config.two_pickers:
            held = np.union1d(held, self._plan(cloth, rng).held)
        self._carry(held, carrying_path(first, self._action, STEP_S) - first.pick)

    def _plan(self, cloth: ClothMesh, rng: np.random.Generator) -> PlannedAction:
        config = self.config
        bounds = np.cumsum([config.folded, config.middle, config.pulled])
        kinds: tuple[Picks, ...] = ("folded", "middle", "pulled", "outline")
        picks = kinds[int(np.searchsorted(bounds, rng.random(), "right"))]
        # A pulled vertex starts at the outline and must be able to move beyond it.
        reach_m = self._pull_reach_m if picks == "pulled" else self._action.reach_m
        return plan_action(cloth, replace(self._action, picks=picks, reach_m=reach_m), rng)

    # Motion

    def _carry(self, held: np.ndarray, ways: Float[np.ndarray, "steps 3"]) -> Attachment:
        """Move vertices along a path [m] relative to their positions, one solver step per point."""
        start = self._solver.positions[:, held].astype(np.float64)
        targets = np.zeros((1, self.mesh.vertex_count, 3))
        strength = np.zeros((1, self.mesh.vertex_count))
        strength[:, held] = 1.0
        for way in ways:
            targets[:, held] = start + way
            self._solver.step(STEP_S, Attachment(targets.copy(), strength))
        return Attachment(targets, strength)

    def _rest(self, recipe: Recipe) -> CrumpledState:
        """Wait for the cloth to come to rest, in the air if it is held."""
        solver, config = self._solver, self.config
        attached, self._attached = self._attached, None
        before, speed, used = solver.positions[0], np.inf, 0.0
        window_s = _WINDOW_STEPS * STEP_S
        while used < config.rest_limit_s - 1e-9:
            for _ in range(_WINDOW_STEPS):
                solver.step(STEP_S, attached)
            used += window_s
            after = solver.positions[0]
            if not np.isfinite(after).all():
                return CrumpledState(recipe, after, np.inf, exploded=True)
            speed = float(np.linalg.norm(after - before, axis=1).max()) / window_s
            before = after
            if speed < REST_SPEED:
                break
        return CrumpledState(recipe, before, speed, exploded=self._exploded(before))

    def _exploded(self, positions: Float32[np.ndarray, "vertices 3"]) -> bool:
        under: Bool[np.ndarray, " vertices"] = positions[:, 2] < -0.5 * self._rest_height_m
        return bool(under.any()) or edge_strain(self.mesh, positions) > self.config.strain_limit


def _aside(distance_m: float, rng: np.random.Generator) -> Float[np.ndarray, " 3"]:
    """Return a horizontal displacement of this length in a random direction [m]."""
    heading = rng.uniform(0.0, 2.0 * np.pi)
    return distance_m * np.array([np.cos(heading), np.sin(heading), 0.0])
