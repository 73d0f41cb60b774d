"""Kernels of contact between vertices and triangles that remember their side.

A vertex near a triangle keeps the side on which it was first seen, so that a layer pushed through
another finds its way back. These kernels find the pairs; `triangle_push_kernels` pushes them apart.
"""

from typing import no_type_check

import warp as wp

from clothtrack.simulation.cells import Walk, block_around, cell_of, next_touching, nth, row_at
from clothtrack.simulation.kernels import Clock

wp.set_module_options({"enable_backward": False})

TRIANGLES_PER_VERTEX = 16
"""Slots of each vertex for triangles that it may touch."""

SLOTS = wp.constant(TRIANGLES_PER_VERTEX)


@no_type_check
@wp.kernel
def count_faces(
    stride: int,
    cells_per_metre: float,
    tolerance: float,
    faces: wp.array(dtype=wp.vec3i),
    face_reach: wp.array(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    counts: wp.array(dtype=int),
    cells: wp.array2d(dtype=int),
    ranks: wp.array2d(dtype=int),
    balls: wp.array2d(dtype=wp.vec4),
    discs: wp.array2d(dtype=wp.vec4),
):
    """Where each triangle may be touched, and its cell; count per cell.

    That is inside a ball (centre, reach [m]; a thousandth more is for rounding) and, seen along the
    triangle's unit normal, inside a disc (normal, squared radius [m^2]): a foot whose weights are
    at least -t is no farther from the centre than 1 + 3 t times the farthest corner.
    """
    environment, thread = wp.tid()
    here = positions[environment]
    widened = 1.001 * (1.0 + 3.0 * tolerance)
    for number in range(thread, faces.shape[0], stride):
        face = nth(number)
        corners = faces[face]
        a = here[nth(corners[0])]
        b = here[nth(corners[1])]
        c = here[nth(corners[2])]
        centre = (a + b + c) / 3.0
        normal = wp.cross(b - a, c - a)
        doubled_area = wp.length(normal)
        farthest = wp.max(
            wp.length_sq(a - centre), wp.max(wp.length_sq(b - centre), wp.length_sq(c - centre))
        )
        radius = widened * widened * farthest
        if doubled_area < 1.0e-9:
            radius = face_reach[face]  # no plane to look along
        cell = cell_of(environment, centre, cells_per_metre)
        cells[environment, face] = cell
        ranks[environment, face] = wp.atomic_add(counts, cell, 1)
        reach = 1.001 * wp.sqrt(face_reach[face])
        balls[environment, face] = wp.vec4(centre[0], centre[1], centre[2], reach)
        normal = normal / (doubled_area + 1.0e-15)
        discs[environment, face] = wp.vec4(normal[0], normal[1], normal[2], radius)


@no_type_check
@wp.kernel
def sort_faces(
    stride: int,
    first: wp.array(dtype=int),
    cells: wp.array2d(dtype=int),
    ranks: wp.array2d(dtype=int),
    balls: wp.array2d(dtype=wp.vec4),
    discs: wp.array2d(dtype=wp.vec4),
    sorted_faces: wp.array(dtype=int),
    sorted_balls: wp.array(dtype=wp.vec4),
    sorted_discs: wp.array(dtype=wp.vec4),
):
    """Put the triangles and their balls in the order of their cells."""
    environment, thread = wp.tid()
    for number in range(thread, cells.shape[1], stride):
        face = nth(number)
        place = nth(first[nth(cells[environment, face])] + ranks[environment, face])
        sorted_faces[place] = face
        sorted_balls[place] = balls[environment, face]
        sorted_discs[place] = discs[environment, face]


@no_type_check
@wp.func
def barycentric(point: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3, normal: wp.vec3):
    """Weights of the corners at the foot of the point; `normal` is the plain cross product."""
    squared = wp.dot(normal, normal) + 1.0e-30
    weight_b = wp.dot(wp.cross(point - a, c - a), normal) / squared
    weight_c = wp.dot(wp.cross(b - a, point - a), normal) / squared
    return wp.vec3(1.0 - weight_b - weight_c, weight_b, weight_c)


@no_type_check
@wp.func
def segment_distance(point: wp.vec3, a: wp.vec3, b: wp.vec3):
    """Distance from a point to the segment from a to b [m]."""
    along = wp.clamp(wp.dot(point - a, b - a) / wp.dot(b - a, b - a), 0.0, 1.0)
    return wp.length(point - a - along * (b - a))


@no_type_check
@wp.func
def triangle_distance(point: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Distance from a point to a triangle [m]."""
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
def share_a_vertex(first: wp.vec3i, second: wp.vec3i):
    """Whether two triangles touch."""
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
    """Side that the vertex remembers for triangles that touch this one and face the same way."""
    votes = wp.int32(0)
    for slot in range(count):
        code = sides[nth(slot)]
        other = faces[nth(wp.abs(code) - 1)]
        if share_a_vertex(face, other):
            a = positions[nth(other[0])]
            facing = wp.cross(positions[nth(other[1])] - a, positions[nth(other[2])] - a)
            if wp.dot(facing, normal) > 0.0:
                votes += wp.where(code > 0, 1, -1)
    return votes


@no_type_check
@wp.struct
class Pair:
    """Side of a triangle on which a vertex is (0: they cannot touch) and distance to keep [m]."""

    side: wp.int32
    distance: wp.float32


@no_type_check
@wp.func
def examine_pair(
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
    """Whether a vertex may touch a triangle before the next search, and from which side."""
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
        distance = wp.min(thickness, triangle_distance(rest[vertex], rest[i], rest[j], rest[k]))
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
    """Put a pair where its triangle's number wants it; the number of pairs then."""
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
@wp.kernel
def find_pairs(
    stride: int,
    clocks: wp.array(dtype=Clock),
    cells_per_metre: float,
    first: wp.array(dtype=int),
    sorted_faces: wp.array(dtype=int),
    sorted_balls: wp.array(dtype=wp.vec4),
    sorted_discs: wp.array(dtype=wp.vec4),
    face_reach: wp.array(dtype=float),
    reach: float,
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

    They are listed by their number, so that no sum depends on how they were found.
    """
    environment, thread = wp.tid()
    here = positions[environment]
    moving = velocities[environment]
    rebuild_s = clocks[0].rebuild_s
    for number in range(thread, here.shape[0], stride):
        vertex = nth(number)
        point = here[vertex]
        near = wp.vec4(point[0], point[1], point[2], 0.0)
        found = int(0)
        block = block_around(point, reach, cells_per_metre)
        for z in range(block.z0, block.z1 + 1):
            for y in range(block.y0, block.y1 + 1):
                row = row_at(environment, y, z)
                end = first[nth(row + block.right + 1)]
                walk = Walk()
                walk.asked = first[nth(row + block.left)]
                next_touching(near, sorted_balls, end, walk)
                while walk.place < end:
                    place = nth(walk.place)
                    next_touching(near, sorted_balls, end, walk)
                    face_number = nth(sorted_faces[place])
                    face = faces[face_number]
                    ball = sorted_balls[place]
                    disc = sorted_discs[place]
                    away = point - wp.vec3(ball[0], ball[1], ball[2])
                    square = wp.dot(away, away)
                    height = wp.dot(away, wp.vec3(disc[0], disc[1], disc[2]))
                    own = face[0] == vertex or face[1] == vertex or face[2] == vertex
                    # One question, because what it is answered can hardly be predicted. Not ">":
                    # what is not a number must not touch either.
                    if (
                        own
                        or not square <= face_reach[face_number]
                        or wp.abs(height) > 1.001 * depth
                        or square - height * height > disc[3]
                    ):
                        continue
                    pair = examine_pair(
                        vertex, face_number, face, thickness, margin, depth, tolerance, rebuild_s,
                        faces, rest, here, moving, old_sides[environment, vertex],
                        old_distances[environment, vertex], old_counts[environment, vertex],
                    )  # fmt: skip
                    if pair.side != 0:
                        found = insert_pair(
                            environment, found, pair.side * (face_number + 1), pair.distance,
                            sides[environment, vertex], distances[environment, vertex], overflows,
                        )  # fmt: skip
        counts[environment, vertex] = found
