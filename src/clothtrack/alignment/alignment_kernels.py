"""Warp kernels of test-time optimisation: objective, analytic gradient, Adam, conjugate gradients.

The objective of a displacement d of the vertices is, with every term a mean of squares [m^2],

    a mean_p |p - x_near(p)|^2 + b mean_ij |d_i - d_j|^2 + c mean_t |x_t - q_t|^2
    + e mean_ij (|x_i - x_j| - l_ij)^2 + f mean_i max(0, h - height_i)^2
    + g sum_i w_i |x_i - m_i|^2

over cloud points p, edges ij, trusted visible vertices t with a partner q_t, and vertices i, some
of which are wanted at a place m_i by followed points of the pictures. One
thread gathers everything that depends on one vertex, so that nothing is added in parallel but
integers; an edge is seen from both of its ends and counts half each time.

Conjugate gradients work on strips of vertices: one thread per strip, and every thread adds up all
strips' partial dot products itself, in one order.
"""

# Warp needs `float(0.0)` for a variable that changes in a loop, and kernels take many arrays.

from typing import no_type_check

import warp as wp

from clothtrack.alignment.nearest_kernels import (
    _NOT_NEGATIVE,
    FIXED_POINT_LENGTH,
    FIXED_POINT_SQUARE,
    Grid,
    Progress,
    record_step,
)

COLUMNS = DATA, RIGIDITY, TWO_WAY, LENGTH, TABLE, MARKS, PARTNERS = tuple(range(7))
"""Columns of the sums that each iteration records."""

_LENGTH_UNIT = wp.constant(wp.float64(FIXED_POINT_LENGTH))
_SQUARE_UNIT = wp.constant(wp.float64(FIXED_POINT_SQUARE))


@no_type_check
@wp.struct
class Weights:
    """Weights of the terms, divided by the counts of their means, and the table's plane.

    `tied` holds the steps of two neighbours together: the rigidity, and the damping.
    """

    data: wp.float32
    rigidity: wp.float32
    tied: wp.float32
    length: wp.float32
    two_way: wp.float32
    marks: wp.float32
    table: wp.float32
    table_normal: wp.vec3
    lowest: wp.float32


@no_type_check
@wp.struct
class Topology:
    """Neighbours of each vertex along edges, with rest lengths [m], in compressed rows."""

    first: wp.array(dtype=wp.int32)
    neighbour: wp.array(dtype=wp.int32)
    rest_length: wp.array(dtype=wp.float32)


@no_type_check
@wp.struct
class Matches:
    """What the observation wants: points per vertex with their sum, partner and mark of each."""

    cloud: wp.array(dtype=wp.vec3)
    pulled_count: wp.array(dtype=wp.int32)
    pulled_sum: wp.array(dtype=wp.int64)
    partner: wp.array(dtype=wp.int32)
    wanted: wp.array(dtype=wp.vec3)
    wanted_weight: wp.array(dtype=wp.float32)


@no_type_check
@wp.struct
class Slope:
    """Half of the objective's gradient at one vertex and the squares seen from it."""

    gradient: wp.vec3
    rigidity: wp.float32
    two_way: wp.float32
    length: wp.float32
    table: wp.float32
    marks: wp.float32


@no_type_check
@wp.func
def _slope(
    vertex: wp.int32,
    topology: Topology,
    matches: Matches,
    weights: Weights,
    partners: wp.int32,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
):
    slope = Slope()
    position = positions[vertex]
    displacement = displacements[vertex]
    count = matches.pulled_count[vertex]
    gradient = wp.vec3()
    if count > 0:
        number = wp.float64(count)
        x = number * wp.float64(position[0]) - (
            wp.float64(matches.pulled_sum[3 * vertex]) / _LENGTH_UNIT
        )
        y = number * wp.float64(position[1]) - (
            wp.float64(matches.pulled_sum[3 * vertex + 1]) / _LENGTH_UNIT
        )
        z = number * wp.float64(position[2]) - (
            wp.float64(matches.pulled_sum[3 * vertex + 2]) / _LENGTH_UNIT
        )
        pull = wp.vec3(wp.float32(x), wp.float32(y), wp.float32(z))
        gradient += weights.data * pull
    if partners > 0:
        partner = matches.partner[vertex]
        if partner >= 0:
            miss = position - matches.cloud[partner]
            gradient += weights.two_way / float(partners) * miss
            slope.two_way = miss[0] * miss[0] + miss[1] * miss[1] + miss[2] * miss[2]
    wanted_weight = matches.wanted_weight[vertex]
    if wanted_weight > 0.0:
        slide = position - matches.wanted[vertex]
        gradient += weights.marks * wanted_weight * slide
        slope.marks = wanted_weight * wp.dot(slide, slide)
    difference_sum = wp.vec3()
    stretch_sum = wp.vec3()
    first = topology.first[vertex]
    end = topology.first[vertex + 1]
    for place in range(first, end):
        difference = displacement - displacements[topology.neighbour[place]]
        difference_sum += difference
        slope.rigidity += 0.5 * wp.dot(difference, difference)
    if weights.length > 0.0:
        for place in range(first, end):
            edge = position - positions[topology.neighbour[place]]
            length = wp.max(wp.length(edge), 1.0e-9)
            stretch = length - topology.rest_length[place]
            stretch_sum += (stretch / length) * edge
            slope.length += 0.5 * stretch * stretch
    gradient += weights.rigidity * difference_sum + weights.length * stretch_sum
    depth = weights.lowest - wp.dot(weights.table_normal, position)
    if depth > 0.0:
        gradient -= weights.table * depth * weights.table_normal
        slope.table = depth * depth
    slope.gradient = gradient
    return slope


@no_type_check
@wp.struct
class Tally:
    """Squares and longest way of the vertices that one thread looks after."""

    rigidity: wp.float64
    two_way: wp.float64
    length: wp.float64
    table: wp.float64
    marks: wp.float64
    stale: wp.float32


@no_type_check
@wp.func
def _add(tally: Tally, slope: Slope):
    tally.rigidity += wp.float64(slope.rigidity)
    tally.two_way += wp.float64(slope.two_way)
    tally.length += wp.float64(slope.length)
    tally.table += wp.float64(slope.table)
    tally.marks += wp.float64(slope.marks)
    return tally


@no_type_check
@wp.func
def _record(tally: Tally, progress: Progress, sums: wp.array2d(dtype=wp.int64)):
    row = progress.iteration[0]
    wp.atomic_add(sums, row, 1, wp.int64(tally.rigidity * _SQUARE_UNIT))
    wp.atomic_add(sums, row, 2, wp.int64(tally.two_way * _SQUARE_UNIT))
    wp.atomic_add(sums, row, 3, wp.int64(tally.length * _SQUARE_UNIT))
    wp.atomic_add(sums, row, 4, wp.int64(tally.table * _SQUARE_UNIT))
    wp.atomic_add(sums, row, 5, wp.int64(tally.marks * _SQUARE_UNIT))
    sums[row, 6] = wp.int64(progress.partners[0])
    wp.atomic_max(progress.next_stale, 0, tally.stale)


@no_type_check
@wp.kernel(enable_backward=False)
def measure(
    topology: Topology,
    matches: Matches,
    weights: Weights,
    progress: Progress,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
    sums: wp.array2d(dtype=wp.int64),
    gradient: wp.array(dtype=wp.vec3),
):
    """Objective (its sums) and gradient at the present displacement."""
    vertex = wp.tid()
    partners = progress.partners[0]
    slope = _slope(vertex, topology, matches, weights, partners, positions, displacements)
    _record(_add(Tally(), slope), progress, sums)
    gradient[vertex] = 2.0 * slope.gradient


@no_type_check
@wp.kernel(enable_backward=False)
def step_adam(
    topology: Topology,
    matches: Matches,
    weights: Weights,
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
    """One step of Adam (D. P. Kingma and J. Ba, arXiv 1412.6980; decays 0.9 and 0.999)."""
    partners = progress.partners[0]
    scale = step_m / (1.0 - wp.float32(progress.decays[0]))
    correction = wp.float32(wp.float64(1.0) / (wp.float64(1.0) - progress.decays[1]))
    tally = Tally()
    start = wp.tid() * strip
    for vertex in range(start, wp.min(start + strip, positions.shape[0])):
        slope = _slope(vertex, topology, matches, weights, partners, positions, displacements)
        tally = _add(tally, slope)
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
        # Only vertices that a search can return count: how far others go is of no interest.
        if searched[vertex]:
            record_step(grid, progress, positions[vertex], position)
            tally.stale = wp.max(tally.stale, wp.length(position - recorded[vertex]))
    _record(tally, progress, sums)


@no_type_check
@wp.struct
class Conjugate:
    """Arrays of the conjugate gradients, one entry per vertex, and partial dot products."""

    unit: wp.array(dtype=wp.vec3)
    own: wp.array(dtype=wp.vec3)
    below: wp.array(dtype=wp.bool)
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
    topology: Topology,
    matches: Matches,
    weights: Weights,
    progress: Progress,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
    sums: wp.array2d(dtype=wp.int64),
    conjugate: Conjugate,
):
    """Set up the linear system of one outer step: fixed matches, stretch along edges only.

    The unknown is the change of the displacement; the right-hand side is half of the negative
    gradient, the matrix is the Gauss-Newton approximation of half of the Hessian, damped where
    edges turn (D. Marquardt, doi:10.1137/0111030): it hardly resists that, and vertices would run
    past the matches that it was made for.
    """
    strip = wp.tid()
    tally = Tally()
    partners = progress.partners[0]
    dots = wp.float64(0.0)
    end = wp.min((strip + 1) * conjugate.strip, positions.shape[0])
    for vertex in range(strip * conjugate.strip, end):
        slope = _slope(vertex, topology, matches, weights, partners, positions, displacements)
        tally = _add(tally, slope)
        own = weights.data * float(matches.pulled_count[vertex])
        if partners > 0 and matches.partner[vertex] >= 0:
            own += weights.two_way / float(partners)
        own += weights.marks * matches.wanted_weight[vertex]
        own_part = wp.vec3(own, own, own)
        normal = weights.table_normal
        below = slope.table > 0.0
        diagonal = own_part
        if below:
            diagonal += weights.table * wp.cw_mul(normal, normal)
        first = topology.first[vertex]
        last = topology.first[vertex + 1]
        diagonal += wp.vec3(weights.tied * float(last - first))
        if weights.length > 0.0:
            for place in range(first, last):
                edge = positions[vertex] - positions[topology.neighbour[place]]
                unit = edge / wp.max(wp.length(edge), 1.0e-9)
                conjugate.unit[place] = unit
                diagonal += weights.length * wp.cw_mul(unit, unit)
        # Without rigidity and length a hidden vertex has no equation: it stays where it is.
        inverse = wp.vec3(
            1.0 / wp.max(diagonal[0], 1.0e-12),
            1.0 / wp.max(diagonal[1], 1.0e-12),
            1.0 / wp.max(diagonal[2], 1.0e-12),
        )
        residual = -slope.gradient
        preconditioned = wp.cw_mul(inverse, residual)
        conjugate.own[vertex] = own_part
        conjugate.below[vertex] = below
        conjugate.inverse_diagonal[vertex] = inverse
        conjugate.solution[vertex] = wp.vec3()
        conjugate.residual[vertex] = residual
        conjugate.direction[vertex] = preconditioned
        dots += wp.float64(wp.dot(residual, preconditioned))
    conjugate.new_residual_dots[strip] = dots
    _record(tally, progress, sums)


@no_type_check
@wp.func
def multiply_strip(strip: wp.int32, topology: Topology, weights: Weights, conjugate: Conjugate):
    """Matrix times search direction, and the direction's curvature."""
    conjugate.residual_dots[strip] = conjugate.new_residual_dots[strip]
    dots = wp.float64(0.0)
    end = wp.min((strip + 1) * conjugate.strip, conjugate.solution.shape[0])
    for vertex in range(strip * conjugate.strip, end):
        here = conjugate.direction[vertex]
        product = wp.cw_mul(conjugate.own[vertex], here)
        if conjugate.below[vertex]:
            normal = weights.table_normal
            product += weights.table * wp.dot(normal, here) * normal
        first = topology.first[vertex]
        last = topology.first[vertex + 1]
        place = int(first)
        if weights.length > 0.0:
            while place < last:
                spot = place & _NOT_NEGATIVE
                place += 1
                neighbour = topology.neighbour[spot] & _NOT_NEGATIVE
                difference = here - conjugate.direction[neighbour]
                unit = conjugate.unit[spot]
                along = weights.length * wp.dot(unit, difference)
                product += weights.tied * difference + along * unit
        else:
            around = wp.vec3()
            while place < last:
                neighbour = topology.neighbour[place & _NOT_NEGATIVE] & _NOT_NEGATIVE
                place += 1
                around += conjugate.direction[neighbour]
            product += weights.tied * (float(last - first) * here - around)
        conjugate.product[vertex] = product
        dots += wp.float64(wp.dot(here, product))
    conjugate.curvature_dots[strip] = dots


@no_type_check
@wp.func
def descend_strip(strip: wp.int32, conjugate: Conjugate):
    """Go to the minimum along the search direction."""
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
def turn_strip(strip: wp.int32, conjugate: Conjugate):
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
def multiply(topology: Topology, weights: Weights, conjugate: Conjugate):
    """`multiply_strip`, a thread per strip."""
    multiply_strip(wp.tid(), topology, weights, conjugate)


@no_type_check
@wp.kernel(enable_backward=False)
def descend(conjugate: Conjugate):
    """`descend_strip`, a thread per strip."""
    descend_strip(wp.tid(), conjugate)


@no_type_check
@wp.kernel(enable_backward=False)
def turn(conjugate: Conjugate):
    """`turn_strip`, a thread per strip."""
    turn_strip(wp.tid(), conjugate)


@no_type_check
@wp.kernel(enable_backward=False)
def solve_alone(topology: Topology, weights: Weights, conjugate: Conjugate, steps: wp.int32):
    """All steps by one thread, for a CPU, where a launch costs more than it would save."""
    for step in range(steps):
        multiply_strip(0, topology, weights, conjugate)
        descend_strip(0, conjugate)
        if step < steps - 1:
            turn_strip(0, conjugate)


@no_type_check
@wp.func
def _objective(weights: Weights, sums: wp.array2d(dtype=wp.int64), row: wp.int32):
    partners = wp.max(sums[row, 6], wp.int64(1))
    return (
        wp.float64(weights.data) * wp.float64(sums[row, 0])
        + wp.float64(weights.rigidity) * wp.float64(sums[row, 1])
        + wp.float64(weights.two_way) * wp.float64(sums[row, 2]) / wp.float64(partners)
        + wp.float64(weights.length) * wp.float64(sums[row, 3])
        + wp.float64(weights.table) * wp.float64(sums[row, 4])
        + wp.float64(weights.marks) * wp.float64(sums[row, 5])
    )


@no_type_check
@wp.kernel(enable_backward=False)
def apply_solution(
    weights: Weights,
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
    """Add the solution to the displacement, and go on in the direction of the last two.

    Not if the objective has risen: the way on is then no longer the way down (B. O'Donoghue and
    E. Candes, "Adaptive restart for accelerated gradient schemes", doi:10.1007/s10208-013-9150-3).
    """
    row = progress.iteration[0]
    ahead = momentum
    if row == last_row:
        ahead = 0.0
    elif row > 0 and _objective(weights, sums, row) > _objective(weights, sums, row - 1):
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
