"""Minimisers of the objective of test-time optimisation: Adam, and alternating least squares."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import warp as wp

from clothtrack.alignment import alignment_kernels as kernels
from clothtrack.alignment import nearest_kernels
from clothtrack.alignment.alignment_config import ADAM_STEP_M, AlignmentConfig
from clothtrack.alignment.nearest import Command, Matcher, launching, made_ready

_REBUILD_AT = frozenset((2, 4, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768))


@dataclass(eq=False)
class Problem:
    """One alignment on the device."""

    centre: np.ndarray
    initial: wp.array
    matcher: Matcher
    matches: object
    topology: object
    point_count: int
    weights: object = None
    scales: dict[str, float] = field(default_factory=dict)

    def vectors(self) -> wp.array:
        """A vector per vertex, zero."""
        return wp.zeros(len(self.initial), dtype=wp.vec3, device=self.initial.device)

    def sums(self, rows: int) -> wp.array:
        """Room for the sums of so many evaluations."""
        return wp.zeros((rows, len(kernels.COLUMNS)), dtype=wp.int64, device=self.initial.device)

    def terms(self, sums: np.ndarray) -> dict[str, np.ndarray]:
        """The weighted terms of the objective [m^2], of evaluations with these sums."""
        scales, partners = self.scales, np.maximum(sums[:, kernels.PARTNERS], 1)
        squares = sums[:, : kernels.PARTNERS] / kernels.FIXED_POINT_SQUARE
        return {
            "chamfer": scales["chamfer"] * squares[:, kernels.DATA],
            "rigidity": scales["rigidity"] * squares[:, kernels.RIGIDITY],
            "two_way": scales["two_way"] / partners * squares[:, kernels.TWO_WAY],
            "length": scales["length"] * squares[:, kernels.LENGTH],
            "table": scales["table"] * squares[:, kernels.TABLE],
            "marks": scales["marks"] * squares[:, kernels.MARKS],
        }

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


def load_kernels(device: str) -> None:
    """Load what a capture needs; a capture on CUDA cannot."""
    wp.load_module(kernels, device=device)
    wp.load_module(nearest_kernels, device=device)


def _captured(work: Callable[[], None], device: wp.Device) -> Callable[[], None]:
    """Record launches as a graph, so that repeating them costs next to nothing in Python.

    Their kernels must have been loaded (`load_kernels`).
    """
    with wp.ScopedCapture(device=device) as capture:
        work()
    return lambda: wp.capture_launch(capture.graph)


def _do_all(commands: list[Command]) -> None:
    for command in commands:
        command()


def solve_adam(problem: Problem, config: AlignmentConfig) -> tuple[np.ndarray, np.ndarray]:
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
                *problem.objective, ADAM_STEP_M, matcher.grid.cells, matcher.searched,
                matcher.grid.recorded, initial, *source, sums, *moments, *target, strip,
            ],
            device=initial.device,
        )  # fmt: skip

    def iterate_twice() -> None:
        iterate(here, there)
        iterate(there, here)

    repeat = _captured(iterate_twice, initial.device) if config.iterations > 1 else iterate_twice
    for iteration in range(0, config.iterations - 1, 2):
        if iteration in _REBUILD_AT:
            matcher.rebuild(here[0])
        repeat()
    if config.iterations % 2:
        iterate(here, there)
        here = there
    problem.measure(*here, sums)
    return here[1].numpy(), sums.numpy()


def solve_icp(problem: Problem, config: AlignmentConfig) -> tuple[np.ndarray, np.ndarray]:
    """Matches fixed, stretch linearised, conjugate gradients; then again."""
    initial, matcher = problem.initial, problem.matcher
    device = initial.device
    positions, displacements = wp.clone(initial), problem.vectors()
    sums = problem.sums(config.iterations + 1)
    conjugate, strips = _conjugate(problem)
    solved = problem.vectors()

    system = [problem.topology, problem.weights, conjugate]

    on_cpu = wp.get_device(device).is_cpu
    linearise = [*problem.objective, positions, displacements, sums, conjugate]
    apply = [
        problem.weights, matcher.progress, sums, config.icp_momentum, config.iterations - 1,
        matcher.grid.cells, matcher.searched, matcher.grid.recorded, initial, conjugate, solved,
        positions, displacements,
    ]  # fmt: skip
    if on_cpu:
        solve = [launching(kernels.solve_alone, 1, [*system, config.icp_inner], device)]
    else:
        solve = [
            launching(kernels.multiply, strips, system, device),
            launching(kernels.descend, strips, [conjugate], device),
            launching(kernels.turn, strips, [conjugate], device),
        ] * config.icp_inner
    step = [
        # Steps are long: searching is cheaper in cells that know where the vertices are now.
        *matcher.rebuilding(positions),
        *matcher.matching(positions, sums),
        launching(kernels.linearise, strips, linearise, device),
        *solve,
        launching(kernels.apply_solution, strips, apply, device),
    ]
    # For so few repetitions recording a graph would cost a CPU more than it saves.
    repeat = (
        partial(_do_all, made_ready(step)) if on_cpu else _captured(partial(_do_all, step), device)
    )
    done = 0
    while done < config.iterations and not _stands_still(problem, sums, done, config):
        repeat()
        done += 1
    problem.measure(positions, displacements, sums)
    return displacements.numpy(), sums.numpy()[: done + 1]


def _stands_still(problem: Problem, sums: wp.array, done: int, config: AlignmentConfig) -> bool:
    """Whether the last two iterations that are measured brought less than they should."""
    if config.icp_tolerance == 0.0 or done < 3:
        return False
    losses = np.sum(list(problem.terms(sums.numpy()[done - 3 : done]).values()), axis=0)
    return bool(losses[2] > (1.0 - config.icp_tolerance) * losses[0])


def _conjugate(problem: Problem) -> tuple[object, int]:
    device, vertices = problem.initial.device, len(problem.initial)
    conjugate = kernels.Conjugate()
    # One strip is enough for one core; a GPU needs many threads.
    conjugate.strip = vertices if wp.get_device(device).is_cpu else 8
    strips = -(-vertices // conjugate.strip)
    edges = len(problem.topology.neighbour)
    conjugate.unit = wp.zeros(edges, dtype=wp.vec3, device=device)
    conjugate.below = wp.zeros(vertices, dtype=wp.bool, device=device)
    for name in ("own", "inverse_diagonal", "solution", "residual", "direction", "product"):
        setattr(conjugate, name, problem.vectors())
    for name in ("residual_dots", "new_residual_dots", "curvature_dots"):
        setattr(conjugate, name, wp.zeros(strips, dtype=wp.float64, device=device))
    return conjugate, strips
