"""Terms of the objective that test-time optimization minimizes.

The objective of a displacement d of the vertices is, with every term a mean of squares [m^2],

    a mean_p |p - x_near(p)|^2 + b mean_ij |d_i - d_j|^2 + c mean_t |x_t - q_t|^2
    + e mean_ij (|x_i - x_j| - l_ij)^2 + f mean_i max(0, h - height_i)^2
    + g sum_i w_i |x_i - m_i|^2

over cloud points p, edges ij, trusted visible vertices t with a partner q_t, and all vertices i, of
which some have a mark m_i.

To add a term, write a function with the signature of `chamfer`, add its weight to `TermWeights`,
and add an entry to `TERMS`; the solvers, their records and the reported losses adapt. One thread
gathers everything that depends on one vertex, so that floating-point numbers are never added in
parallel. An edge is processed from both ends and counts half each time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, no_type_check

import warp as wp

from clothtrack.alignment.nearest_kernels import (
    FIXED_POINT_LENGTH,
    FIXED_POINT_SQUARE,
    Progress,
)
from clothtrack.files.bounds import Checked, NotNegative

TWO_WAY_RANGE_M = (0.004, 0.08)
"""Smallest and largest distance [m] of a vertex and its partner in the cloud. Smaller distances are
the cloud's spacing; larger ones belong to cloth that the camera missed."""

TABLE_WEIGHT = 10.0
"""Weight of the depth below the resting height, as in the reference implementation."""

_LENGTH_UNIT = wp.constant(wp.float64(FIXED_POINT_LENGTH))
_SQUARE_UNIT = wp.constant(wp.float64(FIXED_POINT_SQUARE))


@dataclass(frozen=True)
class TermWeights(Checked):
    """Weights of the terms, each of which is a mean of squares [m^2].

    Attributes:
        chamfer_weight: distance of cloud points to the nearest visible vertex (the paper: 1).
        rigidity_weight: difference of the displacements at the ends of edges (the paper: 10).
        two_way_weight: distance of trusted visible vertices to the nearest cloud point, within
            `TWO_WAY_RANGE_M` (the paper: 0).
        length_weight: stretch of edges relative to the first mesh (the paper: 0).
        marks_weight: distance of vertices to their marks, the targets from followed points of the
            pictures; a mark counts as much as this many cloud points. The paper ignores color (0).
    """

    chamfer_weight: NotNegative = 1.0
    rigidity_weight: NotNegative = 10.0
    two_way_weight: NotNegative = 1.0
    length_weight: NotNegative = 300.0
    marks_weight: NotNegative = 300.0


@no_type_check
@wp.struct
class Scene:
    """Inputs of the residuals of one alignment.

    Neighbors of each vertex along edges, with rest lengths [m], in compressed rows (`first`,
    `neighbor`, `rest_length`); the cloud [m]; per vertex the number of cloud points that it is
    nearest to and their sum (fixed point), its partner in the cloud (-1: none) and its mark [m]
    with a weight; the number of partners; the table's normal and the lowest height of a vertex
    above the origin, along that normal [m].
    """

    first: wp.array(dtype=wp.int32)
    neighbor: wp.array(dtype=wp.int32)
    rest_length: wp.array(dtype=wp.float32)
    cloud: wp.array(dtype=wp.vec3)
    pulled_count: wp.array(dtype=wp.int32)
    pulled_sum: wp.array(dtype=wp.int64)
    partner: wp.array(dtype=wp.int32)
    partner_count: wp.array(dtype=wp.int32)
    mark: wp.array(dtype=wp.vec3)
    mark_weight: wp.array(dtype=wp.float32)
    table_normal: wp.vec3
    lowest: wp.float32


@no_type_check
@wp.struct
class Residual:
    """Contribution of one term at one vertex.

    `gradient` is half of the gradient of the weighted term, `square` the unweighted squares of the
    residuals [m^2]. `stiffness` and `axis_stiffness` are half of the weighted Gauss-Newton Hessian
    of the vertex with itself: the first in all directions, the second along `axis` (unit). At most
    one term may use the axis. Terms of edges leave both 0 and set `_Term.edges` instead.
    """

    gradient: wp.vec3
    square: wp.float32
    stiffness: wp.float32
    axis_stiffness: wp.float32
    axis: wp.vec3


@no_type_check
@wp.func
def chamfer(
    weight: wp.float32,
    vertex: wp.int32,
    scene: Scene,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
):
    """Return the residual of cloud points to their nearest visible vertex, without squares.

    The matcher records the squares.
    """
    residual = Residual()
    count = scene.pulled_count[vertex]
    if count > 0:
        position = positions[vertex]
        number = wp.float64(count)
        pull = wp.vec3()
        for axis in range(3):
            total = wp.float64(scene.pulled_sum[3 * vertex + axis]) / _LENGTH_UNIT
            pull[axis] = wp.float32(number * wp.float64(position[axis]) - total)
        residual.gradient = weight * pull
    residual.stiffness = weight * float(count)
    return residual


@no_type_check
@wp.func
def two_way(
    weight: wp.float32,
    vertex: wp.int32,
    scene: Scene,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
):
    """Return the residual of a trusted visible vertex to its partner in the cloud."""
    residual = Residual()
    partners = scene.partner_count[0]
    if partners > 0:
        partner = scene.partner[vertex]
        if partner >= 0:
            miss = positions[vertex] - scene.cloud[partner]
            share = weight / float(partners)
            residual.gradient = share * miss
            residual.square = miss[0] * miss[0] + miss[1] * miss[1] + miss[2] * miss[2]
            residual.stiffness = share
    return residual


@no_type_check
@wp.func
def marks(
    weight: wp.float32,
    vertex: wp.int32,
    scene: Scene,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
):
    """Return the residual of a vertex to its mark."""
    residual = Residual()
    mark_weight = scene.mark_weight[vertex]
    if mark_weight > 0.0:
        miss = positions[vertex] - scene.mark[vertex]
        residual.gradient = weight * mark_weight * miss
        residual.square = mark_weight * wp.dot(miss, miss)
        residual.stiffness = weight * mark_weight
    return residual


@no_type_check
@wp.func
def rigidity(
    weight: wp.float32,
    vertex: wp.int32,
    scene: Scene,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
):
    """Return the residual of the displacement differences along edges."""
    residual = Residual()
    total = wp.vec3()
    for place in range(scene.first[vertex], scene.first[vertex + 1]):
        difference = displacements[vertex] - displacements[scene.neighbor[place]]
        total += difference
        residual.square += 0.5 * wp.dot(difference, difference)
    residual.gradient = weight * total
    return residual


@no_type_check
@wp.func
def length(
    weight: wp.float32,
    vertex: wp.int32,
    scene: Scene,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
):
    """Return the residual of the edge lengths relative to their rest lengths."""
    residual = Residual()
    if weight > 0.0:
        total = wp.vec3()
        for place in range(scene.first[vertex], scene.first[vertex + 1]):
            edge = positions[vertex] - positions[scene.neighbor[place]]
            now = wp.max(wp.length(edge), 1.0e-9)
            stretch = now - scene.rest_length[place]
            total += (stretch / now) * edge
            residual.square += 0.5 * stretch * stretch
        residual.gradient = weight * total
    return residual


@no_type_check
@wp.func
def table(
    weight: wp.float32,
    vertex: wp.int32,
    scene: Scene,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
):
    """Return the residual of a vertex's depth below its resting height above the table."""
    residual = Residual()
    depth = scene.lowest - wp.dot(scene.table_normal, positions[vertex])
    if depth > 0.0:
        residual.gradient = -(weight * depth * scene.table_normal)
        residual.square = depth * depth
        residual.axis_stiffness = weight
        residual.axis = scene.table_normal
    return residual


@dataclass(frozen=True)
class Sizes:
    """Counts for the means of the terms, and optional inputs of an alignment."""

    points: int
    vertices: int
    edges: int
    marks: bool
    table: bool


@dataclass(frozen=True)
class _Term:
    """One term of the objective.

    Attributes:
        residual: Warp function with the signature of `chamfer`.
        weight: returns the weight of the sum of squares, given the configuration and the counts.
        edges: how the term couples the two ends of an edge in the Gauss-Newton Hessian: not at all,
            in every direction, or along the edge.
        per_partner: divide by the number of partners, which the matcher counts on the device.
    """

    name: str
    residual: wp.Function
    weight: Callable[[TermWeights, Sizes], float]
    edges: Literal["uncoupled", "coupled", "along"] = "uncoupled"
    per_partner: bool = False


# The matcher adds the squares of the first term, because they belong to cloud points.
TERMS = (
    _Term("chamfer", chamfer, lambda config, n: config.chamfer_weight / n.points),
    _Term("two_way", two_way, lambda config, _: config.two_way_weight, per_partner=True),
    _Term("marks", marks, lambda config, n: n.marks * config.marks_weight / n.points),
    _Term("rigidity", rigidity, lambda config, n: config.rigidity_weight / n.edges, "coupled"),
    _Term("length", length, lambda config, n: config.length_weight / n.edges, "along"),
    _Term("table", table, lambda _, n: n.table * TABLE_WEIGHT / n.vertices),
)

TERM_COUNT = len(TERMS)
PARTNERS = TERM_COUNT
"""Column of the sums, after those of the terms, with the number of partners."""

_ON_EDGES = [term.edges != "uncoupled" for term in TERMS]
_STARTS_GROUP = [k > 0 and _ON_EDGES[k] != _ON_EDGES[k - 1] for k in range(TERM_COUNT)]

TermVector = wp.types.vector(length=TERM_COUNT, dtype=wp.float32)
TermSums = wp.types.vector(length=TERM_COUNT, dtype=wp.float64)


@no_type_check
@wp.struct
class Slope:
    """Sum of the residuals of all terms at one vertex, with squares per term."""

    gradient: wp.vec3
    squares: TermVector
    stiffness: wp.float32
    axis_stiffness: wp.float32
    axis: wp.vec3


@no_type_check
@wp.func
def slope_at(
    vertex: wp.int32,
    scene: Scene,
    weights: TermVector,
    positions: wp.array(dtype=wp.vec3),
    displacements: wp.array(dtype=wp.vec3),
):
    """Return half of the objective's gradient at one vertex, its squares and its stiffness."""
    slope = Slope()
    group = wp.vec3()
    for k in range(wp.static(TERM_COUNT)):
        residual = wp.static(TERMS[k].residual)(weights[k], vertex, scene, positions, displacements)
        # Sum the terms of edges before they are added to those of vertices.
        if wp.static(_STARTS_GROUP[k]):
            slope.gradient += group
            group = wp.vec3()
        group += residual.gradient
        slope.squares[k] = residual.square
        slope.stiffness += residual.stiffness
        slope.axis_stiffness += residual.axis_stiffness
        slope.axis += residual.axis
    slope.gradient += group
    return slope


@no_type_check
@wp.struct
class Tally:
    """Squares per term [m^2] and largest motion [m] of the vertices of one thread."""

    squares: TermSums
    stale: wp.float32


@no_type_check
@wp.func
def add_squares(tally: Tally, slope: Slope):
    """Add the squares of one vertex."""
    for k in range(wp.static(TERM_COUNT)):
        tally.squares[k] += wp.float64(slope.squares[k])
    return tally


@no_type_check
@wp.func
def record(tally: Tally, progress: Progress, sums: wp.array2d(dtype=wp.int64)):
    """Add a thread's tally to the sums of this iteration."""
    row = progress.iteration[0]
    for k in range(wp.static(TERM_COUNT)):
        wp.atomic_add(sums, row, k, wp.int64(tally.squares[k] * _SQUARE_UNIT))
    sums[row, wp.static(PARTNERS)] = wp.int64(progress.partners[0])
    wp.atomic_max(progress.next_stale, 0, tally.stale)


@no_type_check
@wp.func
def objective_of(weights: TermVector, sums: wp.array2d(dtype=wp.int64), row: wp.int32):
    """Return the objective of one iteration, in fixed-point units of square meters."""
    partners = wp.float64(wp.max(sums[row, wp.static(PARTNERS)], wp.int64(1)))
    total = wp.float64(0.0)
    for k in range(wp.static(TERM_COUNT)):
        term = wp.float64(weights[k]) * wp.float64(sums[row, k])
        if wp.static(TERMS[k].per_partner):
            term /= partners
        total += term
    return total
