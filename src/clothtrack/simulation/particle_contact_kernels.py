"""Kernels of contact between particles: every vertex is a ball of the cloth's thickness.

After FleX (Macklin et al., "Unified Particle Physics for Real-Time Applications", SIGGRAPH 2014,
doi:10.1145/2601097.2601152, section 6.1): the slip is cut in proportion to the overlap. Pairs that
are nearer than the thickness at rest keep their rest distance.
"""

from typing import no_type_check

import warp as wp

wp.set_module_options({"enable_backward": False})


@no_type_check
@wp.kernel
def find_neighbours(
    grid: wp.uint64,
    reach: float,
    positions: wp.array2d(dtype=wp.vec3),
    neighbours: wp.array3d(dtype=int),
    counts: wp.array2d(dtype=int),
    overflows: wp.array(dtype=int),
):
    """List the vertices within reach of each vertex, in the order of the grid."""
    environment, vertex = wp.tid()
    offset = environment * positions.shape[1]
    position = positions[environment, vertex]
    found = int(0)
    other = int(0)
    query = wp.hash_grid_query(grid, position, reach, environment)
    while wp.hash_grid_query_next(query, other):
        across = position - positions[environment, other - offset]
        if other - offset != vertex and wp.dot(across, across) < reach * reach:
            if found < neighbours.shape[2]:
                neighbours[environment, vertex, found] = other - offset
                found += 1
            else:
                wp.atomic_add(overflows, environment, 1)
    counts[environment, vertex] = found


@no_type_check
@wp.kernel
def push_particles(
    thickness: float,
    rest: wp.array(dtype=wp.vec3),
    friction: wp.array(dtype=float),
    neighbours: wp.array3d(dtype=int),
    counts: wp.array2d(dtype=int),
    inverse_masses: wp.array2d(dtype=float),
    positions: wp.array2d(dtype=wp.vec3),
    start: wp.array2d(dtype=wp.vec3),
    moves: wp.array2d(dtype=wp.vec3),
    stops: wp.array2d(dtype=wp.vec3),
):
    """Average over the touching pairs of what each wants to move this vertex (Jacobi).

    `stops` is the part that ends an approach and so changes the velocity too.
    """
    environment, vertex = wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    stopped = wp.vec3(0.0, 0.0, 0.0)
    weight = inverse_masses[environment, vertex]
    touching = int(0)
    if weight > 0.0:
        position = positions[environment, vertex]
        for slot in range(counts[environment, vertex]):
            other = neighbours[environment, vertex, slot]
            across = position - positions[environment, other]
            squared = wp.dot(across, across)
            if squared < thickness * thickness:
                distance = wp.sqrt(squared) + 1.0e-9
                depth = wp.min(thickness, wp.length(rest[vertex] - rest[other])) - distance
                if depth > 0.0:
                    normal = across / distance
                    slip = position - start[environment, vertex]
                    slip -= positions[environment, other] - start[environment, other]
                    nearing = -wp.dot(slip, normal)
                    slip += nearing * normal
                    cut = wp.min(1.0, friction[environment] * depth / (wp.length(slip) + 1.0e-12))
                    share = weight / (weight + inverse_masses[environment, other])
                    total += share * (depth * normal - cut * slip)
                    stopped += share * (wp.clamp(nearing, 0.0, depth) * normal - cut * slip)
                    touching += 1
    moves[environment, vertex] = total / float(wp.max(touching, 1))
    stops[environment, vertex] = stopped / float(wp.max(touching, 1))
