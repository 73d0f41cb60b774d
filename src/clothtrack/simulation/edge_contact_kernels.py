"""Kernels of contact between edges, where cloth is creased.

Between flat layers vertices and triangles say all there is. Over a crease they do not: the ridge of
one layer cuts through the edges of another while every vertex is still on its side. So edges look
for bent edges nearby. Sums are kept in whole numbers, so that no result depends on the order of
threads.
"""

from typing import no_type_check

import warp as wp

from clothtrack.simulation.cells import Walk, block_around, cell_of, next_touching, nth, row_at
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
    """How two segments pass each other: plain normal, its square, shares along both, gap [m].

    The gap has a sign. All are zero when the lines are nearly parallel or pass beyond the ends.
    """

    normal: wp.vec3
    square: wp.float32
    along_first: wp.float32
    along_second: wp.float32
    gap: wp.float32


@no_type_check
@wp.func
def pass_by(a: wp.vec3, b: wp.vec3, c: wp.vec3, d: wp.vec3):
    """How the segment from a to b passes the segment from c to d."""
    crossing = Crossing()
    first = b - a
    second = d - c
    normal = wp.cross(first, second)
    square = wp.dot(normal, normal)
    between = c - a
    along_first = wp.dot(wp.cross(between, second), normal)
    along_second = wp.dot(wp.cross(between, first), normal)
    low = wp.min(along_first, along_second)
    high = wp.max(along_first, along_second)
    # Most pass each other beyond their ends: they are told before anything is divided.
    if (
        low > 0.0
        and high < square
        and square > _NEARLY_PARALLEL * wp.dot(first, first) * wp.dot(second, second)
    ):
        crossing.normal = normal
        crossing.square = square
        crossing.along_first = along_first / square
        crossing.along_second = along_second / square
        crossing.gap = -wp.dot(between, normal) / wp.sqrt(square)
    return crossing


@no_type_check
@wp.func
def inside(crossing: Crossing):
    """Whether the segments pass each other between their ends."""
    low = wp.min(crossing.along_first, crossing.along_second)
    high = wp.max(crossing.along_first, crossing.along_second)
    return crossing.square > 0.0 and low > 0.0 and high < 1.0


@no_type_check
@wp.func
def share_an_end(one: wp.vec2i, other: wp.vec2i):
    """Whether two edges meet."""
    return (one[0] == other[0] or one[0] == other[1]) or (one[1] == other[0] or one[1] == other[1])


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
@wp.kernel
def find_normals(
    stride: int,
    faces: wp.array(dtype=wp.vec3i),
    positions: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
):
    """Unit normal of every triangle."""
    environment, thread = wp.tid()
    here = positions[environment]
    unit = normals[environment]
    for number in range(thread, faces.shape[0], stride):
        face = nth(number)
        corners = faces[face]
        a = here[nth(corners[0])]
        unit[face] = wp.normalize(wp.cross(here[nth(corners[1])] - a, here[nth(corners[2])] - a))


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
@wp.kernel
def count_bent(
    stride: int,
    clocks: wp.array(dtype=Clock),
    cells_per_metre: float,
    flat: float,
    near: float,
    edges: wp.array(dtype=wp.vec2i),
    sides: wp.array(dtype=wp.vec2i),
    normals: wp.array2d(dtype=wp.vec3),
    positions: wp.array2d(dtype=wp.vec3),
    velocities: wp.array2d(dtype=wp.vec3),
    counts: wp.array(dtype=int),
    cells: wp.array2d(dtype=int),
    ranks: wp.array2d(dtype=int),
    balls: wp.array2d(dtype=wp.vec4),
):
    """The ball of every edge; the cell of every bent or open one, -1 for a flat one."""
    environment, thread = wp.tid()
    here = positions[environment]
    moving = velocities[environment]
    unit = normals[environment]
    around = balls[environment]
    places = cells[environment]
    rebuild_s = clocks[0].rebuild_s
    for number in range(thread, edges.shape[0], stride):
        edge = nth(number)
        ends = edges[edge]
        a = here[nth(ends[0])]
        b = here[nth(ends[1])]
        around[edge] = ball_around(
            a, b, moving[nth(ends[0])], moving[nth(ends[1])], near, rebuild_s
        )
        side = sides[edge]
        places[edge] = -1
        if side[1] >= 0:
            if wp.dot(unit[nth(side[0])], unit[side[1]]) > flat:
                continue
        cell = cell_of(environment, 0.5 * (a + b), cells_per_metre)
        places[edge] = cell
        ranks[environment, edge] = wp.atomic_add(counts, cell, 1)


@no_type_check
@wp.kernel
def sort_bent(
    stride: int,
    first: wp.array(dtype=int),
    cells: wp.array2d(dtype=int),
    ranks: wp.array2d(dtype=int),
    balls: wp.array2d(dtype=wp.vec4),
    sorted_edges: wp.array(dtype=int),
    sorted_balls: wp.array(dtype=wp.vec4),
):
    """Put the bent edges in the order of their cells."""
    environment, thread = wp.tid()
    places = cells[environment]
    for number in range(thread, places.shape[0], stride):
        edge = nth(number)
        cell = places[edge]
        if cell >= 0:
            place = first[cell] + ranks[environment, edge]
            sorted_edges[place] = edge
            sorted_balls[place] = balls[environment, edge]


@no_type_check
@wp.kernel
def find_edges(
    stride: int,
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
    listed: wp.array2d(dtype=int),
    totals: wp.array(dtype=int),
    overflows: wp.array(dtype=int),
):
    """List the bent edges that each edge may touch before the next search, with its side.

    A pair of bent edges is listed by the one with the lower number. `listed` are the edges that
    have a pair, in any order, `totals` is how many.
    """
    environment, thread = wp.tid()
    here = positions[environment]
    moving = velocities[environment]
    around = balls[environment]
    places = cells[environment]
    rebuild_s = clocks[0].rebuild_s
    for number in range(thread, edges.shape[0], stride):
        edge = nth(number)
        ends = edges[edge]
        i = nth(ends[0])
        j = nth(ends[1])
        a = here[i]
        b = here[j]
        middle = 0.5 * (a + b)
        ball = around[edge]
        bent = places[edge] >= 0
        found = int(0)
        block = block_around(middle, reach, cells_per_metre)
        for z in range(block.z0, block.z1 + 1):
            for y in range(block.y0, block.y1 + 1):
                row = row_at(environment, y, z)
                end = first[nth(row + block.right + 1)]
                walk = Walk()
                walk.asked = first[nth(row + block.left)]
                next_touching(ball, sorted_balls, end, walk)
                while walk.place < end:
                    place = nth(walk.place)
                    next_touching(ball, sorted_balls, end, walk)
                    other = nth(sorted_edges[place])
                    if bent and other <= edge:
                        continue
                    far = edges[other]
                    c = nth(far[0])
                    d = nth(far[1])
                    if share_an_end(ends, far):
                        continue
                    crossing = pass_by(a, b, here[c], here[d])
                    if not inside(crossing):
                        continue
                    s = crossing.along_first
                    t = crossing.along_second
                    parting = (1.0 - s) * moving[i]
                    parting += s * moving[j]
                    parting -= (1.0 - t) * moving[c]
                    parting -= t * moving[d]
                    side = wp.where(crossing.gap >= 0.0, 1.0, -1.0)
                    nearing = -side * wp.dot(parting, crossing.normal) / wp.sqrt(crossing.square)
                    allowed = distance + margin + wp.max(nearing, 0.0) * rebuild_s
                    if wp.abs(crossing.gap) > allowed:
                        continue
                    keep = wp.min(distance, rest_distance(rest[i], rest[j], rest[c], rest[d]))
                    if found < partners.shape[2]:
                        code = wp.where(side > 0.0, 1, -1) * (other + 1)
                        partners[environment, edge, found] = code
                        distances[environment, edge, found] = keep
                        found += 1
                    else:
                        wp.atomic_add(overflows, environment, 1)
        counts[environment, edge] = found
        if found > 0:
            listed[environment, wp.atomic_add(totals, environment, 1)] = edge


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
    stride: int,
    clocks: wp.array(dtype=Clock),
    push_out_speed: float,
    friction: wp.array(dtype=float),
    edges: wp.array(dtype=wp.vec2i),
    partners: wp.array3d(dtype=int),
    distances: wp.array3d(dtype=float),
    counts: wp.array2d(dtype=int),
    listed: wp.array2d(dtype=int),
    totals: wp.array(dtype=int),
    inverse_masses: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    start: wp.array2d(dtype=wp.vec3),
    sums: wp.array3d(dtype=wp.int64),
):
    """Push listed edges apart that are nearer than their distance or on the wrong side."""
    environment, thread = wp.tid()
    here = positions[environment]
    before = start[environment]
    mass = inverse_masses[environment]
    longest = push_out_speed * clocks[0].substep_s
    for number in range(thread, totals[environment], stride):
        edge = listed[environment, number]
        ends = edges[edge]
        a = here[ends[0]]
        b = here[ends[1]]
        for slot in range(counts[environment, edge]):
            code = partners[environment, edge, slot]
            far = edges[wp.abs(code) - 1]
            c = here[far[0]]
            d = here[far[1]]
            crossing = pass_by(a, b, c, d)
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
            weight = (1.0 - s) * (1.0 - s) * mass[ends[0]]
            weight += s * s * mass[ends[1]]
            weight += (1.0 - t) * (1.0 - t) * mass[far[0]]
            weight += t * t * mass[far[1]]
            if weight == 0.0:
                continue
            outward = crossing.normal * (side / wp.sqrt(crossing.square))
            slip = (1.0 - s) * (a - before[ends[0]])
            slip += s * (b - before[ends[1]])
            slip -= (1.0 - t) * (c - before[far[0]])
            slip -= t * (d - before[far[1]])
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
    stride: int,
    totals: wp.array(dtype=int),
    sums: wp.array3d(dtype=wp.int64),
    moves: wp.array2d(dtype=wp.vec3),
    stops: wp.array2d(dtype=wp.vec3),
):
    """Average over the active pairs (Jacobi), add to what the triangles want; clear the sums."""
    environment, thread = wp.tid()
    if totals[environment] == 0:
        return
    for vertex in range(thread, sums.shape[1], stride):
        wanted = sums[environment, vertex]
        active = wanted[6]
        if active == wp.int64(0):
            continue
        share = _METRES / wp.max(_METRES * float(active), 1.0)
        moves[environment, vertex] += share * wp.vec3(
            float(wanted[0]), float(wanted[1]), float(wanted[2])
        )
        stops[environment, vertex] += share * wp.vec3(
            float(wanted[3]), float(wanted[4]), float(wanted[5])
        )
        for column in range(7):
            wanted[column] = wp.int64(0)
