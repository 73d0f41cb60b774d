"""Kernels of contact between vertices and triangles that remember their side.

A vertex near a triangle keeps the side on which it was first seen, so that a layer pushed through
another finds its way back. Each pair gives equal and opposite impulses to the vertex and to the
triangle's corners; every vertex then gathers what concerns it, in a fixed order, so that no result
depends on the order of threads.
"""

from typing import no_type_check

import warp as wp

from clothtrack.simulation.kernels import Clock

wp.set_module_options({"enable_backward": False})


@no_type_check
@wp.kernel
def find_centroids(
    faces: wp.array(dtype=wp.vec3i),
    positions: wp.array2d(dtype=wp.vec3),
    centroids: wp.array(dtype=wp.vec3),
):
    """Centre of each triangle [m]."""
    environment, face = wp.tid()
    corners = faces[face]
    total = positions[environment, corners[0]]
    total += positions[environment, corners[1]]
    total += positions[environment, corners[2]]
    centroids[environment * faces.shape[0] + face] = total / 3.0


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
    environment: int,
    vertex: int,
    face: wp.vec3i,
    normal: wp.vec3,
    faces: wp.array(dtype=wp.vec3i),
    positions: wp.array2d(dtype=wp.vec3),
    sides: wp.array3d(dtype=int),
    count: int,
):
    """Side that the vertex remembers for triangles that touch this one and face the same way."""
    votes = int(0)
    for slot in range(count):
        code = sides[environment, vertex, slot]
        other = faces[wp.abs(code) - 1]
        if share_a_vertex(face, other):
            a = positions[environment, other[0]]
            facing = wp.cross(
                positions[environment, other[1]] - a, positions[environment, other[2]] - a
            )
            if wp.dot(facing, normal) > 0.0:
                votes += wp.where(code > 0, 1, -1)
    return votes


@no_type_check
@wp.kernel
def find_pairs(
    clocks: wp.array(dtype=Clock),
    grid: wp.uint64,
    reach: float,
    thickness: float,
    margin: float,
    depth: float,
    tolerance: float,
    faces: wp.array(dtype=wp.vec3i),
    face_reach: wp.array(dtype=float),
    centroids: wp.array(dtype=wp.vec3),
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
    """List the triangles that each vertex may touch before the next search, with its side."""
    environment, vertex = wp.tid()
    offset = environment * faces.shape[0]
    point = positions[environment, vertex]
    remembered = old_counts[environment, vertex]
    found = int(0)
    index = int(0)
    query = wp.hash_grid_query(grid, point, reach, environment)
    while wp.hash_grid_query_next(query, index):
        away = point - centroids[index]
        face_number = index - offset
        if not wp.dot(away, away) <= face_reach[face_number]:  # also refuses what is not a number
            continue
        face = faces[face_number]
        if face[0] == vertex or face[1] == vertex or face[2] == vertex:
            continue
        a = positions[environment, face[0]]
        b = positions[environment, face[1]]
        c = positions[environment, face[2]]
        normal = wp.cross(b - a, c - a)
        doubled_area = wp.length(normal)
        height = wp.dot(point - a, normal) / (doubled_area + 1.0e-15)
        if wp.abs(height) > depth:
            continue
        weights = barycentric(point, a, b, c, normal)
        if wp.min(weights) < -tolerance:
            continue
        side = int(0)
        distance = float(-1.0)
        for slot in range(remembered):
            code = old_sides[environment, vertex, slot]
            if wp.abs(code) == face_number + 1:
                side = wp.where(code > 0, 1, -1)
                distance = old_distances[environment, vertex, slot]
        if side == 0 and remembered > 0:
            votes = vote(environment, vertex, face, normal, faces, positions, old_sides, remembered)
            side = wp.where(votes > 0, 1, wp.where(votes < 0, -1, 0))
        if side == 0:
            side = wp.where(height >= 0.0, 1, -1)
        approach = velocities[environment, vertex]
        for corner in range(3):
            approach -= weights[corner] * velocities[environment, face[corner]]
        nearing = -float(side) * wp.dot(approach, normal) / (doubled_area + 1.0e-15)
        allowed = thickness + margin + wp.max(nearing, 0.0) * clocks[0].rebuild_s
        if float(side) * height > allowed:
            continue
        if distance < 0.0:
            distance = wp.min(
                thickness,
                triangle_distance(rest[vertex], rest[face[0]], rest[face[1]], rest[face[2]]),
            )
        if found < sides.shape[2]:
            sides[environment, vertex, found] = side * (face_number + 1)
            distances[environment, vertex, found] = distance
            found += 1
        else:
            wp.atomic_add(overflows, environment, 1)
    counts[environment, vertex] = found


@no_type_check
@wp.kernel
def list_reactions(
    faces: wp.array(dtype=wp.vec3i),
    sides: wp.array3d(dtype=int),
    counts: wp.array2d(dtype=int),
    reactions: wp.array3d(dtype=int),
    reaction_counts: wp.array2d(dtype=int),
    overflows: wp.array(dtype=int),
):
    """Tell every corner of a listed triangle which pairs push it (pair x 3 + corner)."""
    environment, vertex = wp.tid()
    slots = sides.shape[2]
    for slot in range(counts[environment, vertex]):
        face = faces[wp.abs(sides[environment, vertex, slot]) - 1]
        for corner in range(3):
            place = wp.atomic_add(reaction_counts, environment, face[corner], 1)
            if place < reactions.shape[2]:
                reactions[environment, face[corner], place] = (vertex * slots + slot) * 3 + corner
            else:
                wp.atomic_add(overflows, environment, 1)


@no_type_check
@wp.kernel
def sort_reactions(
    reactions: wp.array3d(dtype=int),
    reaction_counts: wp.array2d(dtype=int),
):
    """Order each corner's reactions, so that sums do not depend on the order of threads."""
    environment, vertex = wp.tid()
    count = wp.min(reaction_counts[environment, vertex], reactions.shape[2])
    reaction_counts[environment, vertex] = count
    for index in range(1, count):
        code = reactions[environment, vertex, index]
        place = int(index)
        while place > 0 and reactions[environment, vertex, place - 1] > code:
            reactions[environment, vertex, place] = reactions[environment, vertex, place - 1]
            place -= 1
        reactions[environment, vertex, place] = code


@no_type_check
@wp.func
def holds_a_corner(environment: int, face: wp.vec3i, inverse_masses: wp.array2d(dtype=float)):
    """Whether a corner of the triangle is held."""
    return (
        inverse_masses[environment, face[0]] == 0.0
        or inverse_masses[environment, face[1]] == 0.0
        or inverse_masses[environment, face[2]] == 0.0
    )


@no_type_check
@wp.kernel
def find_impulses(
    clocks: wp.array(dtype=Clock),
    tolerance: float,
    push_out_speed: float,
    friction: wp.array(dtype=float),
    faces: wp.array(dtype=wp.vec3i),
    sides: wp.array3d(dtype=int),
    distances: wp.array3d(dtype=float),
    counts: wp.array2d(dtype=int),
    inverse_masses: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    start: wp.array2d(dtype=wp.vec3),
    impulses: wp.array3d(dtype=wp.vec3),
    stopping: wp.array3d(dtype=wp.vec3),
    weights: wp.array3d(dtype=wp.vec3),
):
    """Impulse [kg m] of each listed pair that is nearer than its distance or on the wrong side."""
    environment, vertex = wp.tid()
    count = counts[environment, vertex]
    if count == 0:
        return
    point = positions[environment, vertex]
    longest = push_out_speed * clocks[0].substep_s
    for slot in range(count):
        impulses[environment, vertex, slot] = wp.vec3(0.0, 0.0, 0.0)
        code = sides[environment, vertex, slot]
        face = faces[wp.abs(code) - 1]
        a = positions[environment, face[0]]
        b = positions[environment, face[1]]
        c = positions[environment, face[2]]
        normal = wp.cross(b - a, c - a)
        squared = wp.dot(normal, normal)
        if squared < 1.0e-18:
            continue
        outward = normal * (wp.where(code > 0, 1.0, -1.0) / wp.sqrt(squared))
        height = wp.dot(point - a, outward)
        push = distances[environment, vertex, slot] - height
        if push <= 0.0:
            continue
        foot = barycentric(point, a, b, c, normal)
        if wp.min(foot) < -tolerance:
            continue
        push = wp.min(push, longest * wp.where(height > 0.0, 2.0, 1.0))
        weight = inverse_masses[environment, vertex]
        if weight == 0.0 and holds_a_corner(environment, face, inverse_masses):
            continue  # what one hand holds together stays as it was grasped
        slip = point - start[environment, vertex]
        for corner in range(3):
            share = foot[corner]
            weight += share * share * inverse_masses[environment, face[corner]]
            slip -= share * (
                positions[environment, face[corner]] - start[environment, face[corner]]
            )
        if weight == 0.0:
            continue
        nearing = -wp.dot(slip, outward)
        slip += nearing * outward
        cut = wp.min(1.0, friction[environment] * push / (wp.length(slip) + 1.0e-12))
        impulses[environment, vertex, slot] = (push * outward - cut * slip) / weight
        stopping[environment, vertex, slot] = (
            wp.clamp(nearing, 0.0, push) * outward - cut * slip
        ) / weight
        weights[environment, vertex, slot] = foot


@no_type_check
@wp.kernel
def gather_impulses(
    counts: wp.array2d(dtype=int),
    reactions: wp.array3d(dtype=int),
    reaction_counts: wp.array2d(dtype=int),
    impulses: wp.array3d(dtype=wp.vec3),
    stopping: wp.array3d(dtype=wp.vec3),
    weights: wp.array3d(dtype=wp.vec3),
    inverse_masses: wp.array2d(dtype=float),
    moves: wp.array2d(dtype=wp.vec3),
    stops: wp.array2d(dtype=wp.vec3),
):
    """Average over the active pairs of what each wants to move this vertex (Jacobi) [m].

    `stops` is the part that ends an approach and so changes the velocity too.
    """
    environment, vertex = wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    stopped = wp.vec3(0.0, 0.0, 0.0)
    active = int(0)
    for slot in range(counts[environment, vertex]):
        impulse = impulses[environment, vertex, slot]
        if wp.dot(impulse, impulse) > 0.0:
            total += impulse
            stopped += stopping[environment, vertex, slot]
            active += 1
    slots = impulses.shape[2]
    for index in range(reaction_counts[environment, vertex]):
        code = reactions[environment, vertex, index]
        pair = code // 3
        impulse = impulses[environment, pair // slots, pair % slots]
        if wp.dot(impulse, impulse) > 0.0:
            share = weights[environment, pair // slots, pair % slots][code % 3]
            total -= impulse * share
            stopped -= stopping[environment, pair // slots, pair % slots] * share
            active += 1
    share = inverse_masses[environment, vertex] / float(wp.max(active, 1))
    moves[environment, vertex] = share * total
    stops[environment, vertex] = share * stopped
