"""Find edges that pass through triangles of one mesh, by tests of eight boxes at once.

The boxes form a tree of two levels: each block of eight boxes has a box around it, and these boxes
also form blocks of eight. Triangles come first; edges start at the next full block of blocks.
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

wp.set_module_options({"enable_backward": False})

_EIGHT = wp.constant(EIGHT)


@no_type_check
@wp.kernel
def find_boxes(
    points: wp.array(dtype=wp.vec3),
    corners: wp.array3d(dtype=int),
    first_edges: int,
    slack: float,
    boxes: wp.array3d(dtype=float),
    around: wp.array3d(dtype=float),
):
    """Compute boxes of triangles and edges, and the box around each block; one thread per block.

    Boxes of edges are enlarged by `slack` [m], because points are rounded to single precision.
    `corners` are -1 at empty places of a block.
    """
    eight = wp.tid()
    margin = wp.vec3(0.0, 0.0, 0.0)
    if eight >= first_edges:
        margin = wp.vec3(slack, slack, slack)
    whole = no_box()
    for place in range(_EIGHT):
        if corners[eight, 0, place] >= 0:
            a = points[corners[eight, 0, place]]
            b = points[corners[eight, 1, place]]
            c = points[corners[eight, 2, place]]
            box = Box()
            box.low = wp.min(wp.min(a, b), c) - margin
            box.high = wp.max(wp.max(a, b), c) + margin
            put_box(box, boxes, eight, place)
            whole = join(whole, box)
    put_box(whole, around, eight // _EIGHT, eight % _EIGHT)


@no_type_check
@wp.func
def _passes_through(p: wp.vec3d, q: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Return whether a segment crosses the inside of a triangle (signed volumes, strictly)."""
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
def _list_between(
    edges: int,
    faces: int,
    around_faces: Box,
    vertices: wp.array(dtype=wp.vec3d),
    corners: wp.array3d(dtype=int),
    boxes: wp.array3d(dtype=float),
    found: wp.array(dtype=wp.vec2i),
    count: wp.array(dtype=int),
):
    """List the crossings of a block of edges with a block of triangles."""
    edge = wp.int32(0)
    face = wp.int32(0)
    near_edges = wp.uint32(0)
    near_faces = wp.uint32(0)
    find_touching(around_faces, boxes, edges, near_edges)
    while near_edges != wp.uint32(0):
        take_lowest(near_edges, edge)
        i = corners[edges, 0, edge]
        j = corners[edges, 1, edge]
        find_touching(box_at(boxes, edges, edge), boxes, faces, near_faces)
        keep_strangers(i, j, corners, faces, near_faces)
        while near_faces != wp.uint32(0):
            take_lowest(near_faces, face)
            a = vertices[corners[faces, 0, face]]
            b = vertices[corners[faces, 1, face]]
            c = vertices[corners[faces, 2, face]]
            if _passes_through(vertices[i], vertices[j], a, b, c):
                slot = wp.atomic_add(count, 0, 1)
                if slot < found.shape[0]:
                    found[slot] = wp.vec2i(_EIGHT * edges + edge, _EIGHT * faces + face)


@no_type_check
@wp.kernel
def list_crossings(
    vertices: wp.array(dtype=wp.vec3d),
    corners: wp.array3d(dtype=int),
    boxes: wp.array3d(dtype=float),
    around: wp.array3d(dtype=float),
    first_edges: int,
    found: wp.array(dtype=wp.vec2i),
    count: wp.array(dtype=int),
):
    """List in any order the edges and the triangles without a common vertex that they cross.

    Crossings without a free slot are counted but not listed. Candidates whose boxes touch are
    tested in double precision. One thread handles eight blocks of eight edges.
    """
    edge_block = first_edges // _EIGHT + wp.tid()
    whole = around_eight(around, edge_block)
    place = wp.int32(0)
    edge_place = wp.int32(0)
    near_faces = wp.uint32(0)
    near_edges = wp.uint32(0)
    for block in range(first_edges // _EIGHT):
        find_touching(whole, around, block, near_faces)
        while near_faces != wp.uint32(0):
            take_lowest(near_faces, place)
            around_faces = box_at(around, block, place)
            find_touching(around_faces, around, edge_block, near_edges)
            while near_edges != wp.uint32(0):
                take_lowest(near_edges, edge_place)
                _list_between(
                    _EIGHT * edge_block + edge_place, _EIGHT * block + place, around_faces,
                    vertices, corners, boxes, found, count,
                )  # fmt: skip
