"""Kernels of contact between vertices and triangles that store their side.

A vertex near a triangle keeps the side on which it was first found, so that a layer that was pushed
through another returns. These kernels find the pairs; `triangle_push_kernels` pushes them apart.
"""

from typing import no_type_check

import warp as wp

from clothtrack.geometry.boxes import (
    EIGHT,
    Box,
    box_at,
    find_touching,
    join,
    keep_strangers,
    no_box,
    put_box,
    take_lowest,
)
from clothtrack.simulation.kernels import Clock, nth

wp.set_module_options({"enable_backward": False})

TRIANGLES_PER_VERTEX = 16
"""Slots per vertex for triangles that it may touch."""

SLOTS = wp.constant(TRIANGLES_PER_VERTEX)

_EIGHT = wp.constant(EIGHT)
_THIRD = wp.constant(1.0 / 3.0)
# Relative margin of the tests of eight at once over the exact tests, for rounding.
_SLACK = wp.constant(0.002)


@no_type_check
@wp.kernel
def fit_triangles(
    stride: int,
    depth: float,
    tolerance: float,
    numbers: wp.array2d(dtype=int),
    corners: wp.array3d(dtype=int),
    face_reach: wp.array(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    planes: wp.array4d(dtype=float),
    around: wp.array4d(dtype=float),
):
    """Compute where triangles may be touched: planes of each, and a box around each eight [m].

    `planes[eight, k, place]` are the first corner of a triangle (k = 0, 1, 2) [m], its unit normal
    (3, 4, 5) and the gradients of its second (6, 7, 8) and third weight (9, 10, 11) [1/m]. A foot
    whose weights are at least -t lies in the triangle scaled by 1 + 3 t about its center. The
    weights of a degenerate triangle are only rounding errors, and a triangle stretched to many
    times its size may be touched only near its center. For both the planes are zero and reject
    nothing, and the box is that of the reach. For rounding, boxes are enlarged by some thousandths,
    and by a millionth of their coordinates.
    """
    environment, thread = wp.tid()
    here = positions[environment]
    deep = depth * (1.0 + _SLACK)
    widening = 3.0 * (tolerance + _SLACK)
    for number in range(thread, numbers.shape[0], stride):
        eight = nth(number)
        vertices = corners[eight]
        plane = planes[environment, eight]
        whole = no_box()
        for place in range(_EIGHT):
            if vertices[0, place] < 0:
                break
            a = here[nth(vertices[0, place])]
            b = here[nth(vertices[1, place])]
            c = here[nth(vertices[2, place])]
            first = b - a
            second = c - a
            normal = wp.cross(first, second)
            doubled_area = wp.length(normal)
            longest = wp.max(wp.length_sq(first), wp.length_sq(second))
            center = (a + b + c) * _THIRD
            unit = wp.vec3(0.0, 0.0, 0.0)
            to_second = unit
            to_third = unit
            box = Box()
            box.low = center
            box.high = center
            beyond = 1.0e-6 * wp.abs(center)
            square_reach = face_reach[nth(numbers[eight, place])]
            small = longest < 10.0 * square_reach
            if small and doubled_area > 1.0e-3 * (longest + depth * depth):
                inverse = 1.0 / doubled_area
                unit = normal * inverse
                to_second = wp.cross(second * inverse, unit)
                to_third = wp.cross(unit, first * inverse)
                box.low += (1.0 + widening) * (wp.min(wp.min(a, b), c) - center)
                box.high += (1.0 + widening) * (wp.max(wp.max(a, b), c) - center)
                beyond += deep * wp.abs(unit)
            else:
                reach = (1.0 + _SLACK) * wp.sqrt(square_reach)
                beyond += wp.vec3(reach, reach, reach)
            box.low -= beyond
            box.high += beyond
            whole = join(whole, box)
            for axis in range(3):
                plane[axis, place] = a[axis]
                plane[3 + axis, place] = unit[axis]
                plane[6 + axis, place] = to_second[axis]
                plane[9 + axis, place] = to_third[axis]
        put_box(whole, around[environment], eight // _EIGHT, eight % _EIGHT)


_FIND_FACING = """
    const float* plane = planes.data + 96 * (size_t)eight;
    const float x = point[0], y = point[1], z = point[2];
#ifdef __clang__  // All eight in one go.
    typedef float Eight __attribute__((ext_vector_type(8)));
    typedef bool EightBits __attribute__((ext_vector_type(8)));
    typedef Eight EightAnywhere __attribute__((aligned(4)));
    const EightAnywhere* planes_of = reinterpret_cast<const EightAnywhere*>(plane);
    const Eight from_x = x - planes_of[0], from_y = y - planes_of[1], from_z = z - planes_of[2];
    const Eight height = from_x * planes_of[3] + from_y * planes_of[4] + from_z * planes_of[5];
    const Eight second = from_x * planes_of[6] + from_y * planes_of[7] + from_z * planes_of[8];
    const Eight third = from_x * planes_of[9] + from_y * planes_of[10] + from_z * planes_of[11];
    const auto facing = (height <= depth) & (height >= -depth) & (second >= lowest)
        & (third >= lowest) & (second + third <= 1.0f - lowest);
    bits = __builtin_bit_cast(unsigned char, __builtin_convertvector(facing, EightBits));
#else
    bits = 0;
    for (int place = 0; place < 8; ++place, ++plane) {
        const float from_x = x - plane[0], from_y = y - plane[8], from_z = z - plane[16];
        const float height = from_x * plane[24] + from_y * plane[32] + from_z * plane[40];
        const float second = from_x * plane[48] + from_y * plane[56] + from_z * plane[64];
        const float third = from_x * plane[72] + from_y * plane[80] + from_z * plane[88];
        const bool facing = height <= depth && height >= -depth && second >= lowest
            && third >= lowest && second + third <= 1.0f - lowest;
        bits |= (unsigned)facing << place;
    }
#endif
"""


@no_type_check
@wp.func_native(_FIND_FACING)
def _find_facing(
    point: wp.vec3,
    depth: float,
    lowest: float,
    planes: wp.array3d(dtype=float),
    eight: int,
    bits: wp.ref[wp.uint32],
):
    """Set a bit for each triangle of an eight that a point is near.

    The point is near if it is within `depth` [m] of the plane and no weight is below `lowest`.
    """


@no_type_check
@wp.func
def barycentric(point: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3, normal: wp.vec3):
    """Return the barycentric weights of the foot of the point; `normal` is the cross product."""
    squared = wp.dot(normal, normal) + 1.0e-30
    weight_b = wp.dot(wp.cross(point - a, c - a), normal) / squared
    weight_c = wp.dot(wp.cross(b - a, point - a), normal) / squared
    return wp.vec3(1.0 - weight_b - weight_c, weight_b, weight_c)


@no_type_check
@wp.func
def segment_distance(point: wp.vec3, a: wp.vec3, b: wp.vec3):
    """Return the distance from a point to the segment from a to b [m]."""
    along = wp.clamp(wp.dot(point - a, b - a) / wp.dot(b - a, b - a), 0.0, 1.0)
    return wp.length(point - a - along * (b - a))


@no_type_check
@wp.func
def _triangle_distance(point: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Return the distance from a point to a triangle [m]."""
    normal = wp.cross(b - a, c - a)
    weights = barycentric(point, a, b, c, normal)
    if wp.min(weights) >= 0.0:
        return wp.abs(wp.dot(point - a, wp.normalize(normal)))
    return wp.min(
        segment_distance(point, a, b),
        wp.min(segment_distance(point, b, c), segment_distance(point, c, a)),
    )


@no_type_check
@wp.func
def _share_a_vertex(first: wp.vec3i, second: wp.vec3i):
    """Return whether two triangles touch."""
    for i in range(3):
        for j in range(3):
            if first[i] == second[j]:
                return True
    return False


@no_type_check
@wp.func
def vote(
    face: wp.vec3i,
    normal: wp.vec3,
    faces: wp.array(dtype=wp.vec3i),
    positions: wp.array(dtype=wp.vec3),
    sides: wp.array(dtype=int),
    count: int,
):
    """Sum the vertex's stored sides for triangles that touch this one and face the same way."""
    votes = wp.int32(0)
    for slot in range(count):
        code = sides[nth(slot)]
        other = faces[nth(wp.abs(code) - 1)]
        if _share_a_vertex(face, other):
            a = positions[nth(other[0])]
            facing = wp.cross(positions[nth(other[1])] - a, positions[nth(other[2])] - a)
            if wp.dot(facing, normal) > 0.0:
                votes += wp.where(code > 0, 1, -1)
    return votes


@no_type_check
@wp.struct
class Pair:
    """Side of a vertex at a triangle (0: they cannot touch), and distance to keep [m]."""

    side: wp.int32
    distance: wp.float32


@no_type_check
@wp.func
def _examine_pair(
    vertex: int,
    face_number: int,
    face: wp.vec3i,
    thickness: float,
    margin: float,
    depth: float,
    tolerance: float,
    rebuild_s: float,
    faces: wp.array(dtype=wp.vec3i),
    rest: wp.array(dtype=wp.vec3),
    positions: wp.array(dtype=wp.vec3),
    velocities: wp.array(dtype=wp.vec3),
    old_sides: wp.array(dtype=int),
    old_distances: wp.array(dtype=float),
    remembered: int,
):
    """Return the side and distance of a vertex that may touch a triangle before the next search."""
    pair = Pair()
    i = nth(face[0])
    j = nth(face[1])
    k = nth(face[2])
    point = positions[vertex]
    a = positions[i]
    b = positions[j]
    c = positions[k]
    normal = wp.cross(b - a, c - a)
    doubled_area = wp.length(normal)
    height = wp.dot(point - a, normal) / (doubled_area + 1.0e-15)
    if wp.abs(height) > depth:
        return pair
    weights = barycentric(point, a, b, c, normal)
    if wp.min(weights) < -tolerance:
        return pair
    side = wp.int32(0)
    distance = wp.float32(-1.0)
    for number in range(remembered):
        slot = nth(number)
        code = old_sides[slot]
        if wp.abs(code) == face_number + 1:
            side = wp.where(code > 0, 1, -1)
            distance = old_distances[slot]
    if side == 0 and remembered > 0:
        votes = vote(face, normal, faces, positions, old_sides, remembered)
        side = wp.where(votes > 0, 1, wp.where(votes < 0, -1, 0))
    if side == 0:
        side = wp.where(height >= 0.0, 1, -1)
    approach = velocities[vertex]
    approach -= weights[0] * velocities[i]
    approach -= weights[1] * velocities[j]
    approach -= weights[2] * velocities[k]
    nearing = -float(side) * wp.dot(approach, normal) / (doubled_area + 1.0e-15)
    allowed = thickness + margin + wp.max(nearing, 0.0) * rebuild_s
    if float(side) * height > allowed:
        return pair
    if distance < 0.0:
        distance = wp.min(thickness, _triangle_distance(rest[vertex], rest[i], rest[j], rest[k]))
    pair.side = side
    pair.distance = distance
    return pair


@no_type_check
@wp.func
def insert_pair(
    environment: int,
    found: int,
    code: int,
    distance: float,
    sides: wp.array(dtype=int),
    distances: wp.array(dtype=float),
    overflows: wp.array(dtype=int),
):
    """Insert a pair sorted by its triangle's number; return the new number of pairs."""
    count = int(found)
    if count == sides.shape[0]:
        wp.atomic_add(overflows, environment, 1)
        if wp.abs(code) > wp.abs(sides[count - 1]):
            return count
        count -= 1
    slot = int(count)
    while slot > 0 and wp.abs(sides[slot - 1]) > wp.abs(code):
        sides[slot] = sides[slot - 1]
        distances[slot] = distances[slot - 1]
        slot -= 1
    sides[slot] = code
    distances[slot] = distance
    return count + 1


@no_type_check
@wp.func
def _in_reach(
    point: wp.vec3,
    a: wp.vec3,
    b: wp.vec3,
    c: wp.vec3,
    square_reach: float,
    depth: float,
    tolerance: float,
):
    """Return whether a point is where a triangle with little stretch may be touched.

    That is in a ball around its center (squared reach [m^2]) and, seen along the normal, in a disc.
    """
    center = (a + b + c) / 3.0
    normal = wp.cross(b - a, c - a)
    doubled_area = wp.length(normal)
    farthest = wp.max(
        wp.length_sq(a - center), wp.max(wp.length_sq(b - center), wp.length_sq(c - center))
    )
    widened = 1.001 * (1.0 + 3.0 * tolerance)
    radius = widened * widened * farthest
    if doubled_area < 1.0e-9:
        radius = square_reach  # a degenerate triangle has no normal
    away = point - center
    square = wp.dot(away, away)
    height = wp.dot(away, normal / (doubled_area + 1.0e-15))
    # Use "<=" instead of "not >" for the ball, so that NaN does not touch.
    return (
        square <= square_reach
        and not wp.abs(height) > 1.001 * depth
        and not square - height * height > radius
    )


@no_type_check
@wp.kernel
def find_pairs(
    stride: int,
    clocks: wp.array(dtype=Clock),
    groups: wp.array2d(dtype=int),
    numbers: wp.array2d(dtype=int),
    corners: wp.array3d(dtype=int),
    planes: wp.array4d(dtype=float),
    around: wp.array4d(dtype=float),
    top: wp.array4d(dtype=float),
    points: wp.array4d(dtype=float),
    face_reach: wp.array(dtype=float),
    thickness: float,
    margin: float,
    depth: float,
    tolerance: float,
    faces: wp.array(dtype=wp.vec3i),
    rest: wp.array(dtype=wp.vec3),
    positions: wp.array2d(dtype=wp.vec3),
    velocities: wp.array2d(dtype=wp.vec3),
    old_sides: wp.array3d(dtype=int),
    old_distances: wp.array3d(dtype=float),
    old_counts: wp.array2d(dtype=int),
    sides: wp.array3d(dtype=int),
    distances: wp.array3d(dtype=float),
    counts: wp.array2d(dtype=int),
    overflows: wp.array(dtype=int),
):
    """List the triangles that each vertex may touch before the next search, with its side.

    They are sorted by their number, so that no sum depends on the order in which they were found.
    `groups` are the vertices in blocks of eight, `points` are zero-size boxes at their positions.
    """
    environment, thread = wp.tid()
    here = positions[environment]
    mine = points[environment]
    place = wp.int32(0)
    near = wp.uint32(0)
    near_top = wp.uint32(0)
    near_around = wp.uint32(0)
    near_points = wp.uint32(0)
    for number in range(thread, groups.shape[0], stride):
        group = nth(number)
        whole = no_box()
        for n in range(_EIGHT):
            vertex = groups[group, n]
            if vertex >= 0:
                counts[environment, vertex] = 0
                box = Box()
                box.low = here[vertex]
                box.high = box.low
                put_box(box, mine, group, n)
                whole = join(whole, box)
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
                    find_touching(box, mine, group, near_points)
                    while near_points != wp.uint32(0):
                        take_lowest(near_points, place)
                        vertex = nth(groups[group, place])
                        point = here[vertex]
                        _find_facing(
                            point, depth * (1.0 + _SLACK), -(tolerance + _SLACK),
                            planes[environment], eight, near,
                        )  # fmt: skip
                        keep_strangers(vertex, vertex, corners, eight, near)
                        while near != wp.uint32(0):
                            take_lowest(near, place)
                            face_number = nth(numbers[eight, place])
                            face = faces[face_number]
                            if not _in_reach(
                                point, here[nth(face[0])], here[nth(face[1])], here[nth(face[2])],
                                face_reach[face_number], depth, tolerance,
                            ):  # fmt: skip
                                continue
                            pair = _examine_pair(
                                vertex, face_number, face, thickness, margin, depth, tolerance,
                                clocks[0].rebuild_s, faces, rest, here, velocities[environment],
                                old_sides[environment, vertex], old_distances[environment, vertex],
                                old_counts[environment, vertex],
                            )  # fmt: skip
                            if pair.side != 0:
                                counts[environment, vertex] = insert_pair(
                                    environment, counts[environment, vertex],
                                    pair.side * (face_number + 1), pair.distance,
                                    sides[environment, vertex], distances[environment, vertex],
                                    overflows,
                                )  # fmt: skip
