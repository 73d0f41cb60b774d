"""Which edges pass through which triangles of one mesh, found through a tree of boxes."""

from typing import no_type_check

import warp as wp

wp.set_module_options({"enable_backward": False})


@no_type_check
@wp.func
def passes_through(p: wp.vec3d, q: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Whether a segment crosses the inside of a triangle (signed volumes, strictly)."""
    zero = wp.float64(0.0)
    normal = wp.cross(b - a, c - a)
    if wp.dot(normal, p - a) * wp.dot(normal, q - a) >= zero:
        return False
    way = q - p
    u = wp.dot(wp.cross(a - p, b - p), way)
    v = wp.dot(wp.cross(b - p, c - p), way)
    w = wp.dot(wp.cross(c - p, a - p), way)
    above = u > zero and v > zero and w > zero
    below = u < zero and v < zero and w < zero
    return above or below


@no_type_check
@wp.func
def crosses(edge: wp.vec2i, face: wp.vec3i, vertices: wp.array(dtype=wp.vec3d)):
    """Whether an edge passes through a triangle that it has no vertex in common with."""
    for corner in range(3):
        if face[corner] == edge[0] or face[corner] == edge[1]:
            return False
    return passes_through(
        vertices[edge[0]],
        vertices[edge[1]],
        vertices[face[0]],
        vertices[face[1]],
        vertices[face[2]],
    )


@no_type_check
@wp.kernel
def find_crossings(
    tree: wp.uint64,
    vertices: wp.array(dtype=wp.vec3d),
    edges: wp.array(dtype=wp.vec2i),
    faces: wp.array(dtype=wp.vec3i),
    slack: float,
    edge_crosses: wp.array(dtype=wp.uint8),
    face_crossed: wp.array(dtype=wp.uint8),
):
    """Mark edges that pass through a triangle without a common vertex, and those triangles.

    The boxes are of single precision and `slack` wider [m]; what lies in them is tried in double.
    """
    number = wp.tid()
    edge = edges[number]
    p = vertices[edge[0]]
    q = vertices[edge[1]]
    one = wp.vec3(float(p[0]), float(p[1]), float(p[2]))
    other = wp.vec3(float(q[0]), float(q[1]), float(q[2]))
    margin = wp.vec3(slack, slack, slack)
    query = wp.mesh_query_aabb(tree, wp.min(one, other) - margin, wp.max(one, other) + margin)
    index = int(0)
    while wp.mesh_query_aabb_next(query, index):
        face = faces[index]
        if crosses(edge, face, vertices):
            edge_crosses[number] = wp.uint8(1)
            face_crossed[index] = wp.uint8(1)


@no_type_check
@wp.kernel
def list_crossings(
    tree: wp.uint64,
    vertices: wp.array(dtype=wp.vec3d),
    edges: wp.array(dtype=wp.vec2i),
    faces: wp.array(dtype=wp.vec3i),
    slack: float,
    crossed: wp.array2d(dtype=int),
    counts: wp.array(dtype=int),
):
    """List for each edge the triangles without a common vertex that it passes through.

    What finds no slot is counted, not listed. Boxes as in `find_crossings`.
    """
    number = wp.tid()
    edge = edges[number]
    p = vertices[edge[0]]
    q = vertices[edge[1]]
    one = wp.vec3(float(p[0]), float(p[1]), float(p[2]))
    other = wp.vec3(float(q[0]), float(q[1]), float(q[2]))
    margin = wp.vec3(slack, slack, slack)
    query = wp.mesh_query_aabb(tree, wp.min(one, other) - margin, wp.max(one, other) + margin)
    index = int(0)
    count = int(0)
    while wp.mesh_query_aabb_next(query, index):
        face = faces[index]
        if crosses(edge, face, vertices):
            if count < crossed.shape[1]:
                crossed[number, count] = index
            count += 1
    counts[number] = count
