"""Kernels of contact between edges, for creased cloth.

Vertex-triangle contact is sufficient between flat layers but not at a crease. There the ridge of
one layer can cut through the edges of another while every vertex is still on its side. Edges are
therefore tested against bent edges nearby. Sums are kept as integers, so that no result depends on
the order of threads.
"""

from typing import no_type_check

import warp as wp

from clothtrack.geometry.boxes import (
    EIGHT,
    Box,
    around_eight,
    box_at,
    find_touching,
    join,
    keep_strangers,
    no_box,
    put_box,
    take_lowest,
)
from clothtrack.simulation.contact.triangle_contact_kernels import insert_pair, segment_distance
from clothtrack.simulation.kernels import Clock, nth

wp.set_module_options({"enable_backward": False})

EDGES_PER_EDGE = 8
"""Slots per edge for edges that it may touch."""

_EIGHT = wp.constant(EIGHT)
_UNIT = wp.constant(wp.float32(1.0e12))
_METERS = wp.constant(1.0e-12)
_NEARLY_PARALLEL = wp.constant(0.0025)


@no_type_check
@wp.struct
class Crossing:
    """How two segments cross: unscaled normal, its square, positions along both (0 to 1), gap [m].

    The gap is signed. All are zero if the lines are nearly parallel or cross beyond the ends.
    """

    normal: wp.vec3
    square: wp.float32
    along_first: wp.float32
    along_second: wp.float32
    gap: wp.float32


@no_type_check
@wp.func
def _pass_by(a: wp.vec3, b: wp.vec3, c: wp.vec3, d: wp.vec3):
    """Return how the segment from a to b crosses the segment from c to d."""
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
    # Most segments cross beyond their ends; detect them before any division.
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
    """Return whether the segments cross between their ends."""
    low = wp.min(crossing.along_first, crossing.along_second)
    high = wp.max(crossing.along_first, crossing.along_second)
    return crossing.square > 0.0 and low > 0.0 and high < 1.0


@no_type_check
@wp.func
def _rest_distance(a: wp.vec3, b: wp.vec3, c: wp.vec3, d: wp.vec3):
    """Return the distance between two segments in the rest shape [m]."""
    crossing = _pass_by(a, b, c, d)
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
    """Compute the unit normal of every triangle."""
    environment, thread = wp.tid()
    here = positions[environment]
    unit = normals[environment]
    for number in range(thread, faces.shape[0], stride):
        face = nth(number)
        corners = faces[face]
        a = here[nth(corners[0])]
        unit[face] = wp.normalize(wp.cross(here[nth(corners[1])] - a, here[nth(corners[2])] - a))


@no_type_check
@wp.kernel
def fit_edges(
    stride: int,
    clocks: wp.array(dtype=Clock),
    flat: float,
    near: float,
    reach: float,
    numbers: wp.array2d(dtype=int),
    corners: wp.array3d(dtype=int),
    sides: wp.array(dtype=wp.vec2i),
    normals: wp.array2d(dtype=wp.vec3),
    positions: wp.array2d(dtype=wp.vec3),
    velocities: wp.array2d(dtype=wp.vec3),
    boxes: wp.array4d(dtype=float),
    bent: wp.array2d(dtype=wp.uint32),
    around: wp.array4d(dtype=float),
):
    """Compute the box of every edge [m], the bent or open ones of each eight, and their joint box.

    Edges whose boxes do not overlap are not listed as a pair. A box contains the edge, a margin of
    half the distance within which edges are listed, and the travel of the faster end until the
    next search. For rounding it is enlarged by a thousandth, and by a millionth of its coordinates.
    It extends at most `reach` [m] from the middle of the edge, however fast the edge is, because
    otherwise all boxes would overlap after an explosion.
    """
    environment, thread = wp.tid()
    here = positions[environment]
    moving = velocities[environment]
    unit = normals[environment]
    rebuild_s = clocks[0].rebuild_s
    for number in range(thread, numbers.shape[0], stride):
        eight = nth(number)
        bits = wp.uint32(0)
        whole = no_box()
        for place in range(_EIGHT):
            edge = numbers[eight, place]
            if edge < 0:
                break
            i = nth(corners[eight, 0, place])
            j = nth(corners[eight, 1, place])
            box = Box()
            box.low = wp.min(here[i], here[j])
            box.high = wp.max(here[i], here[j])
            fastest = wp.sqrt(wp.max(wp.length_sq(moving[i]), wp.length_sq(moving[j])))
            beyond = 1.001 * (0.5 * near + fastest * rebuild_s)
            beyond += 0.001 * wp.length(box.high - box.low)
            margin = wp.vec3(beyond, beyond, beyond)
            margin += 1.0e-6 * (wp.abs(box.low) + wp.abs(box.high))
            middle = 0.5 * (here[i] + here[j])
            farthest = wp.vec3(reach, reach, reach)
            box.low = wp.max(box.low - margin, middle - farthest)
            box.high = wp.min(box.high + margin, middle + farthest)
            put_box(box, boxes[environment], eight, place)
            side = sides[edge]
            if side[1] >= 0:
                if wp.dot(unit[nth(side[0])], unit[side[1]]) > flat:
                    continue
            bits |= wp.uint32(1) << wp.uint32(place)
            whole = join(whole, box)
        bent[environment, eight] = bits
        put_box(whole, around[environment], eight // _EIGHT, eight % _EIGHT)


@no_type_check
@wp.func
def _side_of(
    ends: wp.vec2i,
    far: wp.vec2i,
    near: float,
    rebuild_s: float,
    positions: wp.array(dtype=wp.vec3),
    velocities: wp.array(dtype=wp.vec3),
):
    """Return the side on which an edge crosses another that it may touch; 0 if it cannot."""
    i = ends[0]
    j = ends[1]
    c = far[0]
    d = far[1]
    crossing = _pass_by(positions[i], positions[j], positions[c], positions[d])
    if not inside(crossing):
        return 0
    s = crossing.along_first
    t = crossing.along_second
    parting = (1.0 - s) * velocities[i]
    parting += s * velocities[j]
    parting -= (1.0 - t) * velocities[c]
    parting -= t * velocities[d]
    side = wp.where(crossing.gap >= 0.0, 1, -1)
    nearing = -float(side) * wp.dot(parting, crossing.normal) / wp.sqrt(crossing.square)
    if wp.abs(crossing.gap) > near + wp.max(nearing, 0.0) * rebuild_s:
        return 0
    return side


@no_type_check
@wp.kernel
def find_edges(
    stride: int,
    clocks: wp.array(dtype=Clock),
    numbers: wp.array2d(dtype=int),
    corners: wp.array3d(dtype=int),
    boxes: wp.array4d(dtype=float),
    bent: wp.array2d(dtype=wp.uint32),
    around: wp.array4d(dtype=float),
    top: wp.array4d(dtype=float),
    distance: float,
    margin: float,
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

    A pair of bent edges is listed at the edge with the lower number. Partners are sorted by their
    number. `listed` contains the edges that have a pair, in any order; `totals` is their count.
    """
    environment, thread = wp.tid()
    here = positions[environment]
    mine = boxes[environment]
    place = wp.int32(0)
    near = wp.uint32(0)
    near_top = wp.uint32(0)
    near_around = wp.uint32(0)
    near_mine = wp.uint32(0)
    for number in range(thread, numbers.shape[0], stride):
        group = nth(number)
        for n in range(_EIGHT):
            if numbers[group, n] >= 0:
                counts[environment, nth(numbers[group, n])] = 0
        whole = around_eight(mine, group)
        for block in range(top.shape[1]):
            find_touching(whole, top[environment], block, near_top)
            while near_top != wp.uint32(0):
                take_lowest(near_top, place)
                eights = nth(_EIGHT * block + place)
                find_touching(whole, around[environment], eights, near_around)
                while near_around != wp.uint32(0):
                    take_lowest(near_around, place)
                    eight = nth(_EIGHT * eights + place)
                    box = box_at(around[environment], eights, place)
                    find_touching(box, mine, group, near_mine)
                    while near_mine != wp.uint32(0):
                        take_lowest(near_mine, place)
                        edge = nth(numbers[group, place])
                        is_bent = (bent[environment, group] >> wp.uint32(place)) & wp.uint32(1)
                        i = nth(corners[group, 0, place])
                        j = nth(corners[group, 1, place])
                        find_touching(box_at(mine, group, place), mine, eight, near)
                        near &= bent[environment, eight]
                        keep_strangers(i, j, corners, eight, near)
                        while near != wp.uint32(0):
                            take_lowest(near, place)
                            other = nth(numbers[eight, place])
                            if is_bent != wp.uint32(0) and other <= edge:
                                continue
                            far = wp.vec2i(
                                nth(corners[eight, 0, place]), nth(corners[eight, 1, place])
                            )
                            side = _side_of(
                                wp.vec2i(i, j), far, distance + margin, clocks[0].rebuild_s, here,
                                velocities[environment],
                            )  # fmt: skip
                            if side != 0:
                                rest_gap = _rest_distance(
                                    rest[i], rest[j], rest[nth(far[0])], rest[nth(far[1])]
                                )
                                counts[environment, edge] = insert_pair(
                                    environment, counts[environment, edge], side * (other + 1),
                                    wp.min(distance, rest_gap), partners[environment, edge],
                                    distances[environment, edge], overflows,
                                )  # fmt: skip
        for n in range(_EIGHT):
            edge = numbers[group, n]
            if edge >= 0:
                if counts[environment, edge] > 0:
                    listed[environment, wp.atomic_add(totals, environment, 1)] = edge


@no_type_check
@wp.func
def _add_share(
    environment: int,
    vertex: int,
    share: float,
    moving: wp.vec3,
    stopping: wp.vec3,
    inverse_masses: wp.array2d(dtype=float),
    sums: wp.array3d(dtype=wp.int64),
):
    """Add to the position change of one vertex from edges."""
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
    """Push apart listed edges that are nearer than their distance or on the wrong side."""
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
            crossing = _pass_by(a, b, c, d)
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
            _add_share(environment, ends[0], 1.0 - s, moving, stopping, inverse_masses, sums)
            _add_share(environment, ends[1], s, moving, stopping, inverse_masses, sums)
            _add_share(environment, far[0], t - 1.0, moving, stopping, inverse_masses, sums)
            _add_share(environment, far[1], -t, moving, stopping, inverse_masses, sums)


@no_type_check
@wp.kernel
def add_to_moves(
    stride: int,
    totals: wp.array(dtype=int),
    sums: wp.array3d(dtype=wp.int64),
    moves: wp.array2d(dtype=wp.vec3),
    stops: wp.array2d(dtype=wp.vec3),
):
    """Add the average over the active pairs (Jacobi) to the triangles' moves; clear the sums."""
    environment, thread = wp.tid()
    if totals[environment] == 0:
        return
    for vertex in range(thread, sums.shape[1], stride):
        wanted = sums[environment, vertex]
        active = wanted[6]
        if active == wp.int64(0):
            continue
        share = _METERS / wp.max(_METERS * float(active), 1.0)
        moves[environment, vertex] += share * wp.vec3(
            float(wanted[0]), float(wanted[1]), float(wanted[2])
        )
        stops[environment, vertex] += share * wp.vec3(
            float(wanted[3]), float(wanted[4]), float(wanted[5])
        )
        for column in range(7):
            wanted[column] = wp.int64(0)
