"""Kernels of contact between edges, where cloth is creased.

Between flat layers vertices and triangles say all there is. Over a crease they do not: the ridge of
one layer cuts through the edges of another while every vertex is still on its side. So edges look
for bent edges nearby. Sums are kept in whole numbers, so that no result depends on the order of
threads.
"""

from typing import no_type_check

import warp as wp

from clothtrack.simulation.cells import block_around, cell_of, row_at
from clothtrack.simulation.kernels import Clock
from clothtrack.simulation.triangle_contact_kernels import segment_distance

wp.set_module_options({"enable_backward": False})

EDGES_PER_EDGE = 8
"""Slots of each edge for edges that it may touch."""

_UNIT = wp.constant(wp.float32(1.0e12))
_METRES = wp.constant(1.0e-12)
_NEARLY_PARALLEL = wp.constant(0.0025)


@no_type_check
@wp.struct
class Crossing:
    """How two lines pass each other: plain normal, its square, shares along both, signed gap [m].

    `normal` is zero when they are nearly parallel.
    """

    normal: wp.vec3
    square: wp.float32
    along_first: wp.float32
    along_second: wp.float32
    gap: wp.float32


@no_type_check
@wp.func
def pass_by(a: wp.vec3, b: wp.vec3, c: wp.vec3, d: wp.vec3):
    """How the line from a to b passes the line from c to d."""
    crossing = Crossing()
    first = b - a
    second = d - c
    normal = wp.cross(first, second)
    square = wp.dot(normal, normal)
    if square > _NEARLY_PARALLEL * wp.dot(first, first) * wp.dot(second, second):
        between = c - a
        crossing.normal = normal
        crossing.square = square
        crossing.along_first = wp.dot(wp.cross(between, second), normal) / square
        crossing.along_second = wp.dot(wp.cross(between, first), normal) / square
        crossing.gap = -wp.dot(between, normal) / wp.sqrt(square)
    return crossing


@no_type_check
@wp.func
def inside(crossing: Crossing):
    """Whether both lines pass each other between their ends."""
    low = wp.min(crossing.along_first, crossing.along_second)
    high = wp.max(crossing.along_first, crossing.along_second)
    return crossing.square > 0.0 and low > 0.0 and high < 1.0


@no_type_check
@wp.func
def rest_distance(a: wp.vec3, b: wp.vec3, c: wp.vec3, d: wp.vec3):
    """Distance between two segments in the rest shape [m]."""
    crossing = pass_by(a, b, c, d)
    if inside(crossing):
        return wp.abs(crossing.gap)
    return wp.min(
        wp.min(segment_distance(a, c, d), segment_distance(b, c, d)),
        wp.min(segment_distance(c, a, b), segment_distance(d, a, b)),
    )


@no_type_check
@wp.func
def face_normal(environment: int, face: wp.vec3i, positions: wp.array2d(dtype=wp.vec3)):
    """Unit normal of a triangle."""
    a = positions[environment, face[0]]
    return wp.normalize(
        wp.cross(positions[environment, face[1]] - a, positions[environment, face[2]] - a)
    )


@no_type_check
@wp.func
def ball_around(
    a: wp.vec3, b: wp.vec3, velocity_a: wp.vec3, velocity_b: wp.vec3, near: float, time: float
):
    """Centre and radius [m] of a ball: edges whose balls are apart may not be listed as a pair.

    It holds the edge, half of the distance within which edges are listed, and how far the faster
    end flies until the next search. A thousandth more is for rounding.
    """
    fastest = wp.sqrt(wp.max(wp.dot(velocity_a, velocity_a), wp.dot(velocity_b, velocity_b)))
    radius = 0.5 * wp.length(b - a) + 0.5 * near + fastest * time
    middle = 0.5 * (a + b)
    return wp.vec4(middle[0], middle[1], middle[2], 1.001 * radius)


@no_type_check
@wp.func
def balls_touch(one: wp.vec4, other: wp.vec4):
    """Whether two balls have a point in common."""
    x = one[0] - other[0]
    y = one[1] - other[1]
    z = one[2] - other[2]
    radii = one[3] + other[3]
    return x * x + y * y + z * z <= radii * radii


@no_type_check
@wp.kernel
def count_bent(
    clocks: wp.array(dtype=Clock),
    cells_per_metre: float,
    flat: float,
    near: float,
    edges: wp.array(dtype=wp.vec2i),
    sides: wp.array(dtype=wp.vec2i),
    faces: wp.array(dtype=wp.vec3i),
    positions: wp.array2d(dtype=wp.vec3),
    velocities: wp.array2d(dtype=wp.vec3),
    counts: wp.array(dtype=int),
    cells: wp.array2d(dtype=int),
    ranks: wp.array2d(dtype=int),
    balls: wp.array2d(dtype=wp.vec4),
):
    """The ball of every edge; the cell of every bent or open one, -1 for a flat one."""
    environment, edge = wp.tid()
    ends = edges[edge]
    a = positions[environment, ends[0]]
    b = positions[environment, ends[1]]
    balls[environment, edge] = ball_around(
        a, b, velocities[environment, ends[0]], velocities[environment, ends[1]], near,
        clocks[0].rebuild_s,
    )  # fmt: skip
    side = sides[edge]
    cells[environment, edge] = -1
    if side[1] >= 0:
        one = face_normal(environment, faces[side[0]], positions)
        other = face_normal(environment, faces[side[1]], positions)
        if wp.dot(one, other) > flat:
            return
    cell = cell_of(environment, 0.5 * (a + b), cells_per_metre)
    cells[environment, edge] = cell
    ranks[environment, edge] = wp.atomic_add(counts, cell, 1)


@no_type_check
@wp.kernel
def sort_bent(
    first: wp.array(dtype=int),
    cells: wp.array2d(dtype=int),
    ranks: wp.array2d(dtype=int),
    balls: wp.array2d(dtype=wp.vec4),
    sorted_edges: wp.array(dtype=int),
    sorted_balls: wp.array(dtype=wp.vec4),
):
    """Put the bent edges in the order of their cells."""
    environment, edge = wp.tid()
    cell = cells[environment, edge]
    if cell >= 0:
        place = first[cell] + ranks[environment, edge]
        sorted_edges[place] = edge
        sorted_balls[place] = balls[environment, edge]


@no_type_check
@wp.kernel
def find_edges(
    clocks: wp.array(dtype=Clock),
    cells_per_metre: float,
    first: wp.array(dtype=int),
    cells: wp.array2d(dtype=int),
    sorted_edges: wp.array(dtype=int),
    balls: wp.array2d(dtype=wp.vec4),
    sorted_balls: wp.array(dtype=wp.vec4),
    reach: float,
    distance: float,
    margin: float,
    edges: wp.array(dtype=wp.vec2i),
    rest: wp.array(dtype=wp.vec3),
    positions: wp.array2d(dtype=wp.vec3),
    velocities: wp.array2d(dtype=wp.vec3),
    partners: wp.array3d(dtype=int),
    distances: wp.array3d(dtype=float),
    counts: wp.array2d(dtype=int),
    totals: wp.array(dtype=int),
    overflows: wp.array(dtype=int),
):
    """List the bent edges that each edge may touch before the next search, with its side.

    A pair of bent edges is listed by the one with the lower number.
    """
    environment, edge = wp.tid()
    ends = edges[edge]
    a = positions[environment, ends[0]]
    b = positions[environment, ends[1]]
    middle = 0.5 * (a + b)
    ball = balls[environment, edge]
    bent = cells[environment, edge] >= 0
    found = wp.int32(0)
    block = block_around(middle, reach, cells_per_metre)
    for z in range(block.z0, block.z1 + 1):
        for y in range(block.y0, block.y1 + 1):
            row = row_at(environment, y, z)
            for place in range(first[row + block.left], first[row + block.right + 1]):
                if not balls_touch(ball, sorted_balls[place]):
                    continue
                other = sorted_edges[place]
                if bent and other <= edge:
                    continue
                far = edges[other]
                if far[0] == ends[0] or far[0] == ends[1] or far[1] == ends[0] or far[1] == ends[1]:
                    continue
                c = positions[environment, far[0]]
                d = positions[environment, far[1]]
                crossing = pass_by(a, b, c, d)
                if not inside(crossing):
                    continue
                s = crossing.along_first
                t = crossing.along_second
                parting = (1.0 - s) * velocities[environment, ends[0]]
                parting += s * velocities[environment, ends[1]]
                parting -= (1.0 - t) * velocities[environment, far[0]]
                parting -= t * velocities[environment, far[1]]
                side = wp.where(crossing.gap >= 0.0, 1.0, -1.0)
                nearing = -side * wp.dot(parting, crossing.normal) / wp.sqrt(crossing.square)
                allowed = distance + margin + wp.max(nearing, 0.0) * clocks[0].rebuild_s
                if wp.abs(crossing.gap) > allowed:
                    continue
                keep = wp.min(
                    distance,
                    rest_distance(rest[ends[0]], rest[ends[1]], rest[far[0]], rest[far[1]]),
                )
                if found < partners.shape[2]:
                    partners[environment, edge, found] = wp.where(side > 0.0, 1, -1) * (other + 1)
                    distances[environment, edge, found] = keep
                    found += 1
                else:
                    wp.atomic_add(overflows, environment, 1)
    counts[environment, edge] = found
    if found > 0:
        wp.atomic_add(totals, environment, found)


@no_type_check
@wp.func
def add_share(
    environment: int,
    vertex: int,
    share: float,
    moving: wp.vec3,
    stopping: wp.vec3,
    inverse_masses: wp.array2d(dtype=float),
    sums: wp.array3d(dtype=wp.int64),
):
    """Add to what the edges want to move one vertex."""
    weight = share * inverse_masses[environment, vertex] * _UNIT
    for axis in range(3):
        wp.atomic_add(sums, environment, vertex, axis, wp.int64(weight * moving[axis]))
        wp.atomic_add(sums, environment, vertex, axis + 3, wp.int64(weight * stopping[axis]))
    wp.atomic_add(sums, environment, vertex, 6, wp.int64(wp.abs(share) * _UNIT))


@no_type_check
@wp.kernel
def push_edges(
    clocks: wp.array(dtype=Clock),
    push_out_speed: float,
    friction: wp.array(dtype=float),
    edges: wp.array(dtype=wp.vec2i),
    partners: wp.array3d(dtype=int),
    distances: wp.array3d(dtype=float),
    counts: wp.array2d(dtype=int),
    inverse_masses: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    start: wp.array2d(dtype=wp.vec3),
    sums: wp.array3d(dtype=wp.int64),
):
    """Push listed edges apart that are nearer than their distance or on the wrong side."""
    environment, edge = wp.tid()
    count = counts[environment, edge]
    if count == 0:
        return
    ends = edges[edge]
    a = positions[environment, ends[0]]
    b = positions[environment, ends[1]]
    longest = push_out_speed * clocks[0].substep_s
    for slot in range(count):
        code = partners[environment, edge, slot]
        far = edges[wp.abs(code) - 1]
        crossing = pass_by(a, b, positions[environment, far[0]], positions[environment, far[1]])
        if not inside(crossing):
            continue
        side = wp.where(code > 0, 1.0, -1.0)
        gap = side * crossing.gap
        push = distances[environment, edge, slot] - gap
        if push <= 0.0:
            continue
        if gap <= 0.0:
            push = wp.min(push, longest)
        s = crossing.along_first
        t = crossing.along_second
        weight = (1.0 - s) * (1.0 - s) * inverse_masses[environment, ends[0]]
        weight += s * s * inverse_masses[environment, ends[1]]
        weight += (1.0 - t) * (1.0 - t) * inverse_masses[environment, far[0]]
        weight += t * t * inverse_masses[environment, far[1]]
        if weight == 0.0:
            continue
        outward = crossing.normal * (side / wp.sqrt(crossing.square))
        slip = (1.0 - s) * (a - start[environment, ends[0]])
        slip += s * (b - start[environment, ends[1]])
        slip -= (1.0 - t) * (positions[environment, far[0]] - start[environment, far[0]])
        slip -= t * (positions[environment, far[1]] - start[environment, far[1]])
        nearing = -wp.dot(slip, outward)
        slip += nearing * outward
        cut = wp.min(1.0, friction[environment] * push / (wp.length(slip) + 1.0e-12))
        moving = (push * outward - cut * slip) / weight
        stopping = (wp.clamp(nearing, 0.0, push) * outward - cut * slip) / weight
        add_share(environment, ends[0], 1.0 - s, moving, stopping, inverse_masses, sums)
        add_share(environment, ends[1], s, moving, stopping, inverse_masses, sums)
        add_share(environment, far[0], t - 1.0, moving, stopping, inverse_masses, sums)
        add_share(environment, far[1], -t, moving, stopping, inverse_masses, sums)


@no_type_check
@wp.kernel
def add_to_moves(
    totals: wp.array(dtype=int),
    sums: wp.array3d(dtype=wp.int64),
    moves: wp.array2d(dtype=wp.vec3),
    stops: wp.array2d(dtype=wp.vec3),
):
    """Average over the active pairs (Jacobi), add to what the triangles want; clear the sums."""
    environment, vertex = wp.tid()
    if totals[environment] == 0:
        return
    active = sums[environment, vertex, 6]
    if active == wp.int64(0):
        return
    share = _METRES / wp.max(_METRES * float(active), 1.0)
    moves[environment, vertex] += share * wp.vec3(
        float(sums[environment, vertex, 0]),
        float(sums[environment, vertex, 1]),
        float(sums[environment, vertex, 2]),
    )
    stops[environment, vertex] += share * wp.vec3(
        float(sums[environment, vertex, 3]),
        float(sums[environment, vertex, 4]),
        float(sums[environment, vertex, 5]),
    )
    for column in range(7):
        sums[environment, vertex, column] = wp.int64(0)
