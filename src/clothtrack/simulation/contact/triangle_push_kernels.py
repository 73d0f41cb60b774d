"""Kernels that push apart the pairs listed by vertex-triangle contact.

Each pair applies equal and opposite impulses to the vertex and to the triangle's corners. On a GPU
every pair's impulse is stored first, and every vertex then gathers its impulses in a fixed order.
On a CPU one thread goes through the pairs of an environment and adds each impulse to its vertices.
Both compute the same sums in a different order; neither depends on the order of threads.
"""

from typing import no_type_check

import warp as wp

from clothtrack.simulation.contact.triangle_contact_kernels import SLOTS, barycentric
from clothtrack.simulation.kernels import Clock, nth

wp.set_module_options({"enable_backward": False})


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
    """List for every corner of a listed triangle the pairs that push it (pair x 3 + corner)."""
    environment, vertex = wp.tid()
    for slot in range(counts[environment, vertex]):
        face = faces[wp.abs(sides[environment, vertex, slot]) - 1]
        for corner in range(3):
            place = wp.atomic_add(reaction_counts, environment, face[corner], 1)
            if place < reactions.shape[2]:
                reactions[environment, face[corner], place] = (vertex * SLOTS + slot) * 3 + corner
            else:
                wp.atomic_add(overflows, environment, 1)


@no_type_check
@wp.kernel
def sort_reactions(
    reactions: wp.array3d(dtype=int),
    reaction_counts: wp.array2d(dtype=int),
):
    """Sort each corner's reactions, so that sums do not depend on the order of threads."""
    environment, vertex = wp.tid()
    count = wp.min(reaction_counts[environment, vertex], reactions.shape[2])
    reaction_counts[environment, vertex] = count
    for index in range(1, count):
        code = reactions[environment, vertex, index]
        place = wp.int32(index)
        while place > 0 and reactions[environment, vertex, place - 1] > code:
            reactions[environment, vertex, place] = reactions[environment, vertex, place - 1]
            place -= 1
        reactions[environment, vertex, place] = code


@no_type_check
@wp.struct
class _Impulse:
    """Effect of a pair on its vertex: impulse, the part that ends an approach [kg m], foot.

    The corners get the opposite, weighted by the foot. All are zero if the pair does not touch.
    """

    moving: wp.vec3
    stopping: wp.vec3
    foot: wp.vec3


@no_type_check
@wp.func
def pair_impulse(
    vertex: int,
    code: int,
    distance: float,
    longest: float,
    tolerance: float,
    friction: float,
    face: wp.vec3i,
    inverse_masses: wp.array(dtype=float),
    positions: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=wp.vec3),
):
    """Return the impulse of a listed pair that is nearer than its distance or on the wrong side."""
    impulse = _Impulse()
    point = positions[vertex]
    i = nth(face[0])
    j = nth(face[1])
    k = nth(face[2])
    a = positions[i]
    b = positions[j]
    c = positions[k]
    normal = wp.cross(b - a, c - a)
    squared = wp.dot(normal, normal)
    if squared < 1.0e-18:
        return impulse
    outward = normal * (wp.where(code > 0, 1.0, -1.0) / wp.sqrt(squared))
    height = wp.dot(point - a, outward)
    push = distance - height
    if push <= 0.0:
        return impulse
    foot = barycentric(point, a, b, c, normal)
    if wp.min(foot) < -tolerance:
        return impulse
    if height <= 0.0:
        push = wp.min(push, longest)
    own = inverse_masses[vertex]
    weights = wp.vec3(inverse_masses[i], inverse_masses[j], inverse_masses[k])
    if own == 0.0 and (weights[0] == 0.0 or weights[1] == 0.0 or weights[2] == 0.0):
        return impulse  # cloth that one picker holds together stays as it was grasped
    weight = own + wp.dot(wp.cw_mul(foot, foot), weights)
    if weight == 0.0:
        return impulse
    slip = point - start[vertex]
    slip -= foot[0] * (a - start[i]) + foot[1] * (b - start[j]) + foot[2] * (c - start[k])
    nearing = -wp.dot(slip, outward)
    slip += nearing * outward
    cut = wp.min(1.0, friction * push / (wp.length(slip) + 1.0e-12))
    impulse.moving = (push * outward - cut * slip) / weight
    impulse.stopping = (wp.clamp(nearing, 0.0, push) * outward - cut * slip) / weight
    impulse.foot = foot
    return impulse


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
    """Compute the impulse [kg m] of each pair nearer than its distance or on the wrong side."""
    environment, vertex = wp.tid()
    longest = push_out_speed * clocks[0].substep_s
    for slot in range(counts[environment, vertex]):
        code = sides[environment, vertex, slot]
        impulse = pair_impulse(
            vertex, code, distances[environment, vertex, slot], longest, tolerance,
            friction[environment], faces[wp.abs(code) - 1], inverse_masses[environment],
            positions[environment], start[environment],
        )  # fmt: skip
        impulses[environment, vertex, slot] = impulse.moving
        stopping[environment, vertex, slot] = impulse.stopping
        weights[environment, vertex, slot] = impulse.foot


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
    """Average the position changes of each vertex over its active pairs (Jacobi) [m].

    A pair is weighted by its share in the vertex, so that a pair whose foot is far from this corner
    does not weaken a pair that presses on the vertex itself. `stops` is the part that ends an
    approach and therefore also changes the velocity.
    """
    environment, vertex = wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    stopped = wp.vec3(0.0, 0.0, 0.0)
    active = wp.float32(0.0)
    for slot in range(counts[environment, vertex]):
        impulse = impulses[environment, vertex, slot]
        if wp.dot(impulse, impulse) > 0.0:
            total += impulse
            stopped += stopping[environment, vertex, slot]
            active += 1.0
    for index in range(reaction_counts[environment, vertex]):
        code = reactions[environment, vertex, index]
        pair = code // 3
        impulse = impulses[environment, pair // SLOTS, pair % SLOTS]
        if wp.dot(impulse, impulse) > 0.0:
            share = weights[environment, pair // SLOTS, pair % SLOTS][code % 3]
            total -= impulse * share
            stopped -= stopping[environment, pair // SLOTS, pair % SLOTS] * share
            active += wp.abs(share)
    share = inverse_masses[environment, vertex] / wp.max(active, 1.0)
    moves[environment, vertex] = share * total
    stops[environment, vertex] = share * stopped


@no_type_check
@wp.kernel
def scatter_impulses(
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
    active: wp.array2d(dtype=float),
    moves: wp.array2d(dtype=wp.vec3),
    stops: wp.array2d(dtype=wp.vec3),
):
    """Do what `find_impulses` and `gather_impulses` do, with one thread per environment.

    `active` is scratch: the shares of the active pairs in each vertex.
    """
    environment = wp.tid()
    longest = push_out_speed * clocks[0].substep_s
    mass = inverse_masses[environment]
    here = positions[environment]
    before = start[environment]
    moved = moves[environment]
    stopped = stops[environment]
    sums = active[environment]
    for number in range(mass.shape[0]):
        vertex = nth(number)
        moved[vertex] = wp.vec3(0.0, 0.0, 0.0)
        stopped[vertex] = wp.vec3(0.0, 0.0, 0.0)
        sums[vertex] = 0.0
    for number in range(mass.shape[0]):
        vertex = nth(number)
        for listed in range(counts[environment, vertex]):
            slot = nth(listed)
            code = sides[environment, vertex, slot]
            face = faces[nth(wp.abs(code) - 1)]
            impulse = pair_impulse(
                vertex, code, distances[environment, vertex, slot], longest, tolerance,
                friction[environment], face, mass, here, before,
            )  # fmt: skip
            if wp.dot(impulse.moving, impulse.moving) > 0.0:
                moved[vertex] = moved[vertex] + impulse.moving
                stopped[vertex] = stopped[vertex] + impulse.stopping
                sums[vertex] = sums[vertex] + 1.0
                for corner in range(3):
                    to = nth(face[corner])
                    share = impulse.foot[corner]
                    moved[to] = moved[to] - share * impulse.moving
                    stopped[to] = stopped[to] - share * impulse.stopping
                    sums[to] = sums[to] + wp.abs(share)
    for number in range(mass.shape[0]):
        vertex = nth(number)
        share = wp.where(sums[vertex] > 0.0, mass[vertex] / wp.max(sums[vertex], 1.0), 1.0)
        moved[vertex] = share * moved[vertex]
        stopped[vertex] = share * stopped[vertex]
