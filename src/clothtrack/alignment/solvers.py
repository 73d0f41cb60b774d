"""Solvers of test-time optimization: Adam, and Gauss-Newton steps with fixed matches.

A solver is a frozen object that contains its settings. Its method `solve` takes a `Problem` and
returns the displacement of every vertex [m] and the sums of every evaluation.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp

from clothtrack.alignment import nearest_kernels, solver_kernels, terms_kernels
from clothtrack.alignment.nearest import Matcher, do_all, launching, made_ready
from clothtrack.alignment.terms_kernels import PARTNERS, TERM_COUNT, TERMS
from clothtrack.files.bounds import Checked, Count, NotNegative, Share

ADAM_STEP_M = 1e-3
"""Step of Adam [m]: approximately the largest move of a vertex in one iteration."""

_REBUILD_AT = frozenset((2, 4, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768))


@dataclass(frozen=True, eq=False)
class Problem:
    """One alignment on the device.

    Attributes:
        initial: vertices [m] at zero displacement, relative to their center.
        scales: weight of the sum of squares of each of `TERMS`.
    """

    initial: wp.array
    matcher: Matcher
    scene: object
    scales: tuple[float, ...]

    def vectors(self) -> wp.array:
        """Return a zero vector per vertex."""
        return wp.zeros(len(self.initial), dtype=wp.vec3, device=self.initial.device)

    def sums(self, rows: int) -> wp.array:
        """Return zeros for the sums of this many evaluations."""
        return wp.zeros((rows, TERM_COUNT + 1), dtype=wp.int64, device=self.initial.device)

    def terms(self, sums: np.ndarray) -> dict[str, np.ndarray]:
        """Return the weighted terms of the objective [m^2] from the sums of evaluations."""
        partners = np.maximum(sums[:, PARTNERS], 1)
        squares = sums[:, :PARTNERS] / nearest_kernels.FIXED_POINT_SQUARE
        return {
            term.name: (scale / partners if term.per_partner else scale) * squares[:, column]
            for column, (term, scale) in enumerate(zip(TERMS, self.scales, strict=True))
        }

    @property
    def weights(self) -> object:
        """Weights of the terms, in the form that kernels take."""
        return terms_kernels.TermVector(*self.scales)

    @property
    def objective(self) -> list[object]:
        """First arguments of every kernel that evaluates the objective."""
        return [self.scene, self.weights, self.matcher.progress]

    def measure(self, positions: wp.array, displacements: wp.array, sums: wp.array) -> wp.array:
        """Update the matches and record the objective; return its gradient [m^2 per m]."""
        self.matcher.launch(positions, sums)
        gradient = self.vectors()
        wp.launch(
            solver_kernels.measure,
            dim=len(positions),
            inputs=[*self.objective, positions, displacements, sums, gradient],
            device=positions.device,
        )
        return gradient


def load_kernels(device: str) -> None:
    """Load the modules that a capture needs, because a CUDA capture cannot load them."""
    wp.load_module(solver_kernels, device=device)
    wp.load_module(nearest_kernels, device=device)


def _captured(work: Callable[[], None], device: wp.Device) -> Callable[[], None]:
    """Record launches as a graph, so that repeating them costs almost no Python time.

    Their kernels must have been loaded (`load_kernels`).
    """
    with wp.ScopedCapture(device=device) as capture:
        work()
    return lambda: wp.capture_launch(capture.graph)


@dataclass(frozen=True)
class Adam(Checked):
    """Adam with new matches in every iteration, as in the paper.

    Attributes:
        step_m: length of a step [m].
    """

    iterations: Count = 200
    step_m: NotNegative = ADAM_STEP_M

    def solve(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Return the displacement of every vertex [m] and the sums of every evaluation."""
        initial, matcher = problem.initial, problem.matcher
        moments = problem.vectors(), problem.vectors()
        strip = 64 if wp.get_device(initial.device).is_cpu else 1
        sums = problem.sums(self.iterations + 1)
        here = wp.clone(initial), problem.vectors()
        there = wp.clone(initial), problem.vectors()

        def iterate(source: tuple[wp.array, wp.array], target: tuple[wp.array, wp.array]) -> None:
            matcher.launch(source[0], sums)
            wp.launch(
                solver_kernels.step_adam,
                dim=-(-len(initial) // strip),
                inputs=[
                    *problem.objective, self.step_m, matcher.grid.cells, matcher.searched,
                    matcher.grid.recorded, initial, *source, sums, *moments, *target, strip,
                ],
                device=initial.device,
            )  # fmt: skip

        def iterate_twice() -> None:
            iterate(here, there)
            iterate(there, here)

        repeat = _captured(iterate_twice, initial.device) if self.iterations > 1 else iterate_twice
        for iteration in range(0, self.iterations - 1, 2):
            if iteration in _REBUILD_AT:
                matcher.rebuild(here[0])
            repeat()
        if self.iterations % 2:
            iterate(here, there)
            here = there
        problem.measure(*here, sums)
        return here[1].numpy(), sums.numpy()


@dataclass(frozen=True)
class GaussNewton(Checked):
    """Gauss-Newton steps by conjugate gradients, each with fixed matches: "icp".

    It is five to ten times faster than Adam and reaches the same objective.

    Attributes:
        iterations: maximum number of iterations, each with new matches.
        momentum: share of the last step that is added to the next.
        damping: resistance to the rotation of an edge in one step, relative to the resistance to
            stretch. Without it rotations cost nothing, so vertices oscillate: they move to their
            nearest points, find others there, and move back. It changes the path, not the minimum.
        tolerance: end when two iterations together lower the objective by a smaller share; 0 does
            all iterations.
    """

    iterations: Count = 30
    inner: Count = 12
    momentum: float = 0.8
    damping: NotNegative = 0.2
    tolerance: Share = 0.0

    def solve(self, problem: Problem) -> tuple[np.ndarray, np.ndarray]:
        """Return the displacement of every vertex [m] and the sums of every evaluation."""
        initial, matcher = problem.initial, problem.matcher
        device = initial.device
        positions, displacements = wp.clone(initial), problem.vectors()
        sums = problem.sums(self.iterations + 1)
        conjugate, strips = self._system(problem)
        solved = problem.vectors()

        system = [problem.scene, conjugate]

        on_cpu = wp.get_device(device).is_cpu
        linearise = [*problem.objective, positions, displacements, sums, conjugate]
        apply = [
            problem.weights, matcher.progress, sums, self.momentum, self.iterations - 1,
            matcher.grid.cells, matcher.searched, matcher.grid.recorded, initial, conjugate, solved,
            positions, displacements,
        ]  # fmt: skip
        if on_cpu:
            solve = [launching(solver_kernels.solve_alone, 1, [*system, self.inner], device)]
        else:
            solve = [
                launching(solver_kernels.multiply, strips, system, device),
                launching(solver_kernels.descend, strips, [conjugate], device),
                launching(solver_kernels.turn, strips, [conjugate], device),
            ] * self.inner
        step = [
            # Steps are long, so the search is faster in cells with the current positions.
            *matcher.rebuilding(positions),
            *matcher.matching(positions, sums),
            launching(solver_kernels.linearise, strips, linearise, device),
            *solve,
            launching(solver_kernels.apply_solution, strips, apply, device),
        ]
        # On a CPU recording a graph would cost more than it saves in so few repetitions.
        repeat = (
            partial(do_all, made_ready(step))
            if on_cpu
            else _captured(partial(do_all, step), device)
        )
        done = 0
        while done < self.iterations and not self._has_converged(problem, sums, done):
            repeat()
            done += 1
        problem.measure(positions, displacements, sums)
        return displacements.numpy(), sums.numpy()[: done + 1]

    def _has_converged(self, problem: Problem, sums: wp.array, done: int) -> bool:
        """Return whether the last two iterations lowered the objective by less than allowed."""
        if self.tolerance == 0.0 or done < 3:
            return False
        losses = np.sum(list(problem.terms(sums.numpy()[done - 3 : done]).values()), axis=0)
        return bool(losses[2] > (1.0 - self.tolerance) * losses[0])

    def _system(self, problem: Problem) -> tuple[object, int]:
        """Allocate the linear system; return it and the number of strips."""
        device, vertices = problem.initial.device, len(problem.initial)
        conjugate = solver_kernels.Conjugate()
        scaled = list(zip(TERMS, problem.scales, strict=True))
        coupled, along = (
            sum(scale for term, scale in scaled if term.edges == kind)
            for kind in ("coupled", "along")
        )
        conjugate.coupled, conjugate.along = coupled + self.damping * along, along
        # One strip is enough for one core; a GPU needs many threads.
        conjugate.strip = vertices if wp.get_device(device).is_cpu else 8
        strips = -(-vertices // conjugate.strip)
        edges = len(problem.scene.neighbor)
        conjugate.unit = wp.zeros(edges, dtype=wp.vec3, device=device)
        for name in ("stiffness", "axis_stiffness"):
            setattr(conjugate, name, wp.zeros(vertices, dtype=wp.float32, device=device))
        for name in ("axis", "inverse_diagonal", "solution", "residual", "direction", "product"):
            setattr(conjugate, name, problem.vectors())
        for name in ("residual_dots", "new_residual_dots", "curvature_dots"):
            setattr(conjugate, name, wp.zeros(strips, dtype=wp.float64, device=device))
        return conjugate, strips
