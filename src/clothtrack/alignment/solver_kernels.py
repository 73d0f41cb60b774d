"""Warp kernels of the solvers of test-time optimization: Adam, and Gauss-Newton steps.

Conjugate gradients work on strips of vertices with one thread per strip. Every thread sums the
partial dot products of all strips itself, in a fixed order.
"""

# Warp needs `float(0.0)` for a variable that changes in a loop, and kernels take many arrays.

from typing import no_type_check

import warp as wp

from clothtrack.alignment.nearest_kernels import _NOT_NEGATIVE, Grid, Progress, record_step
from clothtrack.alignment.terms_kernels import (
    Scene,
    Tally,
    TermVector,
    add_squares,
    objective_of,
    record,
    slope_at,
)


@no_type_check
@wp.kernel(enable_backward=False)
def measure(
    scene: Scene,
    weights: TermVector,
    progress: Progress,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
    sums: wp.array2d(dtype=wp.int64),
    gradient: wp.array(dtype=wp.vec3),
):
    """Compute the objective (its sums) and its gradient at the current displacement."""
    vertex = wp.tid()
    slope = slope_at(vertex, scene, weights, positions, displacements)
    record(add_squares(Tally(), slope), progress, sums)
    gradient[vertex] = 2.0 * slope.gradient


@no_type_check
@wp.kernel(enable_backward=False)
def step_adam(
    scene: Scene,
    weights: TermVector,
    progress: Progress,
    step_m: wp.float32,
    grid: Grid,
    searched: wp.array(dtype=wp.bool),
    recorded: wp.array(dtype=wp.vec3),
    initial: wp.array(dtype=wp.vec3),
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
    sums: wp.array2d(dtype=wp.int64),
    first_moment: wp.array(dtype=wp.vec3),
    second_moment: wp.array(dtype=wp.vec3),
    new_positions: wp.array(dtype=wp.vec3),
    new_displacements: wp.array(dtype=wp.vec3),
    strip: wp.int32,
):
    """Do one step of Adam (D. P. Kingma and J. Ba, arXiv 1412.6980; decays 0.9 and 0.999)."""
    scale = step_m / (1.0 - wp.float32(progress.decays[0]))
    correction = wp.float32(wp.float64(1.0) / (wp.float64(1.0) - progress.decays[1]))
    tally = Tally()
    start = wp.tid() * strip
    for vertex in range(start, wp.min(start + strip, positions.shape[0])):
        slope = slope_at(vertex, scene, weights, positions, displacements)
        tally = add_squares(tally, slope)
        gradient = 2.0 * slope.gradient
        first = 0.9 * first_moment[vertex] + 0.1 * gradient
        second = 0.999 * second_moment[vertex] + 0.001 * wp.cw_mul(gradient, gradient)
        first_moment[vertex] = first
        second_moment[vertex] = second
        displacement = displacements[vertex] - scale * wp.vec3(
            first[0] / (wp.sqrt(second[0] * correction) + 1.0e-8),
            first[1] / (wp.sqrt(second[1] * correction) + 1.0e-8),
            first[2] / (wp.sqrt(second[2] * correction) + 1.0e-8),
        )
        position = initial[vertex] + displacement
        new_displacements[vertex] = displacement
        new_positions[vertex] = position
        # Record only the vertices that a search can return.
        if searched[vertex]:
            record_step(grid, progress, positions[vertex], position)
            tally.stale = wp.max(tally.stale, wp.length(position - recorded[vertex]))
    record(tally, progress, sums)


@no_type_check
@wp.struct
class Conjugate:
    """The linear system and the state of the conjugate gradients.

    The matrix couples the two ends of every edge by `coupled` in all directions and by `along` in
    the direction of the edge; `unit` are the unit vectors of the edges. Each vertex has its own
    `stiffness`, and an `axis_stiffness` along an `axis`. Arrays have one entry per vertex, and
    arrays of partial dot products have one per strip.
    """

    coupled: wp.float32
    along: wp.float32
    unit: wp.array(dtype=wp.vec3)
    stiffness: wp.array(dtype=wp.float32)
    axis_stiffness: wp.array(dtype=wp.float32)
    axis: wp.array(dtype=wp.vec3)
    inverse_diagonal: wp.array(dtype=wp.vec3)
    solution: wp.array(dtype=wp.vec3)
    residual: wp.array(dtype=wp.vec3)
    direction: wp.array(dtype=wp.vec3)
    product: wp.array(dtype=wp.vec3)
    residual_dots: wp.array(dtype=wp.float64)
    new_residual_dots: wp.array(dtype=wp.float64)
    curvature_dots: wp.array(dtype=wp.float64)
    strip: wp.int32


@no_type_check
@wp.func
def _sum(values: wp.array(dtype=wp.float64)):
    total = wp.float64(0.0)
    for place in range(values.shape[0]):
        total += values[place]
    return total


@no_type_check
@wp.kernel(enable_backward=False)
def linearise(
    scene: Scene,
    weights: TermVector,
    progress: Progress,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
    sums: wp.array2d(dtype=wp.int64),
    conjugate: Conjugate,
):
    """Set up the linear system of one outer step: fixed matches, stretch along edges only.

    The unknown is the change of the displacement. The right-hand side is half of the negative
    gradient. The matrix is the Gauss-Newton approximation of half of the Hessian, with damping of
    edge rotations (D. Marquardt, doi:10.1137/0111030). Without damping the matrix hardly resists
    rotations, and vertices would overshoot the fixed matches.
    """
    strip = wp.tid()
    tally = Tally()
    dots = wp.float64(0.0)
    end = wp.min((strip + 1) * conjugate.strip, positions.shape[0])
    for vertex in range(strip * conjugate.strip, end):
        slope = slope_at(vertex, scene, weights, positions, displacements)
        tally = add_squares(tally, slope)
        axis = slope.axis
        diagonal = wp.vec3(slope.stiffness)
        diagonal += slope.axis_stiffness * wp.cw_mul(axis, axis)
        first = scene.first[vertex]
        last = scene.first[vertex + 1]
        diagonal += wp.vec3(conjugate.coupled * float(last - first))
        if conjugate.along > 0.0:
            for place in range(first, last):
                edge = positions[vertex] - positions[scene.neighbor[place]]
                unit = edge / wp.max(wp.length(edge), 1.0e-9)
                conjugate.unit[place] = unit
                diagonal += conjugate.along * wp.cw_mul(unit, unit)
        # Without rigidity and length a hidden vertex has no equation and stays in place.
        inverse = wp.vec3(
            1.0 / wp.max(diagonal[0], 1.0e-12),
            1.0 / wp.max(diagonal[1], 1.0e-12),
            1.0 / wp.max(diagonal[2], 1.0e-12),
        )
        residual = -slope.gradient
        preconditioned = wp.cw_mul(inverse, residual)
        conjugate.stiffness[vertex] = slope.stiffness
        conjugate.axis_stiffness[vertex] = slope.axis_stiffness
        conjugate.axis[vertex] = axis
        conjugate.inverse_diagonal[vertex] = inverse
        conjugate.solution[vertex] = wp.vec3()
        conjugate.residual[vertex] = residual
        conjugate.direction[vertex] = preconditioned
        dots += wp.float64(wp.dot(residual, preconditioned))
    conjugate.new_residual_dots[strip] = dots
    record(tally, progress, sums)


@no_type_check
@wp.func
def _multiply_strip(strip: wp.int32, scene: Scene, conjugate: Conjugate):
    """Compute the matrix times the search direction, and the direction's curvature."""
    conjugate.residual_dots[strip] = conjugate.new_residual_dots[strip]
    dots = wp.float64(0.0)
    end = wp.min((strip + 1) * conjugate.strip, conjugate.solution.shape[0])
    for vertex in range(strip * conjugate.strip, end):
        here = conjugate.direction[vertex]
        product = conjugate.stiffness[vertex] * here
        if conjugate.axis_stiffness[vertex] > 0.0:
            axis = conjugate.axis[vertex]
            product += conjugate.axis_stiffness[vertex] * wp.dot(axis, here) * axis
        first = scene.first[vertex]
        last = scene.first[vertex + 1]
        place = int(first)
        if conjugate.along > 0.0:
            while place < last:
                spot = place & _NOT_NEGATIVE
                place += 1
                neighbor = scene.neighbor[spot] & _NOT_NEGATIVE
                difference = here - conjugate.direction[neighbor]
                unit = conjugate.unit[spot]
                along = conjugate.along * wp.dot(unit, difference)
                product += conjugate.coupled * difference + along * unit
        else:
            around = wp.vec3()
            while place < last:
                neighbor = scene.neighbor[place & _NOT_NEGATIVE] & _NOT_NEGATIVE
                place += 1
                around += conjugate.direction[neighbor]
            product += conjugate.coupled * (float(last - first) * here - around)
        conjugate.product[vertex] = product
        dots += wp.float64(wp.dot(here, product))
    conjugate.curvature_dots[strip] = dots


@no_type_check
@wp.func
def _descend_strip(strip: wp.int32, conjugate: Conjugate):
    """Move to the minimum along the search direction."""
    residual_dot = _sum(conjugate.residual_dots)
    curvature = _sum(conjugate.curvature_dots)
    length = float(0.0)
    if curvature > wp.float64(0.0):
        length = wp.float32(residual_dot / curvature)
    dots = wp.float64(0.0)
    end = wp.min((strip + 1) * conjugate.strip, conjugate.solution.shape[0])
    for vertex in range(strip * conjugate.strip, end):
        conjugate.solution[vertex] += length * conjugate.direction[vertex]
        residual = conjugate.residual[vertex] - length * conjugate.product[vertex]
        conjugate.residual[vertex] = residual
        preconditioned = wp.cw_mul(conjugate.inverse_diagonal[vertex], residual)
        dots += wp.float64(wp.dot(residual, preconditioned))
    conjugate.new_residual_dots[strip] = dots


@no_type_check
@wp.func
def _turn_strip(strip: wp.int32, conjugate: Conjugate):
    """Make the next search direction conjugate to the last."""
    before = _sum(conjugate.residual_dots)
    now = _sum(conjugate.new_residual_dots)
    factor = float(0.0)
    if before > wp.float64(0.0):
        factor = wp.float32(now / before)
    end = wp.min((strip + 1) * conjugate.strip, conjugate.solution.shape[0])
    for vertex in range(strip * conjugate.strip, end):
        preconditioned = wp.cw_mul(conjugate.inverse_diagonal[vertex], conjugate.residual[vertex])
        conjugate.direction[vertex] = preconditioned + factor * conjugate.direction[vertex]


@no_type_check
@wp.kernel(enable_backward=False)
def multiply(scene: Scene, conjugate: Conjugate):
    """Run `_multiply_strip` with one thread per strip."""
    _multiply_strip(wp.tid(), scene, conjugate)


@no_type_check
@wp.kernel(enable_backward=False)
def descend(conjugate: Conjugate):
    """Run `_descend_strip` with one thread per strip."""
    _descend_strip(wp.tid(), conjugate)


@no_type_check
@wp.kernel(enable_backward=False)
def turn(conjugate: Conjugate):
    """Run `_turn_strip` with one thread per strip."""
    _turn_strip(wp.tid(), conjugate)


@no_type_check
@wp.kernel(enable_backward=False)
def solve_alone(scene: Scene, conjugate: Conjugate, steps: wp.int32):
    """Do all steps in one thread, for a CPU, where a launch costs more than it saves."""
    for step in range(steps):
        _multiply_strip(0, scene, conjugate)
        _descend_strip(0, conjugate)
        if step < steps - 1:
            _turn_strip(0, conjugate)


@no_type_check
@wp.kernel(enable_backward=False)
def apply_solution(
    weights: TermVector,
    progress: Progress,
    sums: wp.array2d(dtype=wp.int64),
    momentum: wp.float32,
    last_row: wp.int32,
    grid: Grid,
    searched: wp.array(dtype=wp.bool),
    recorded: wp.array(dtype=wp.vec3),
    initial: wp.array(dtype=wp.vec3),
    conjugate: Conjugate,
    solved: wp.array(dtype=wp.vec3),
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
):
    """Add the solution to the displacement, plus momentum along the last two solutions.

    There is no momentum after the objective has risen, because it then no longer points downhill
    (B. O'Donoghue and E. Candes, "Adaptive restart for accelerated gradient schemes",
    doi:10.1007/s10208-013-9150-3).
    """
    row = progress.iteration[0]
    ahead = momentum
    if row == last_row:
        ahead = 0.0
    elif row > 0 and objective_of(weights, sums, row) > objective_of(weights, sums, row - 1):
        ahead = 0.0
    stale = float(0.0)
    strip = wp.tid()
    end = wp.min((strip + 1) * conjugate.strip, positions.shape[0])
    for vertex in range(strip * conjugate.strip, end):
        solution = displacements[vertex] + conjugate.solution[vertex]
        displacement = solution + ahead * (solution - solved[vertex])
        solved[vertex] = solution
        position = initial[vertex] + displacement
        if searched[vertex]:
            record_step(grid, progress, positions[vertex], position)
            stale = wp.max(stale, wp.length(position - recorded[vertex]))
        displacements[vertex] = displacement
        positions[vertex] = position
    wp.atomic_max(progress.next_stale, 0, stale)
