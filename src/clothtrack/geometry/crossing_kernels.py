"""Which edges pass through which triangles of one mesh, found through boxes that are asked at once.

Boxes lie eight by eight: `boxes[eight, k, place]` are the lower (k = 0, 1, 2) and the upper corner
(k = 3, 4, 5) of one of eight [m]. Around each eight there is another box, and these lie eight by
eight as well. Triangles come first, edges after them from a whole eight of eights on.
"""

from typing import no_type_check

import warp as wp

wp.set_module_options({"enable_backward": False})

EIGHT = 8
"""Boxes that are asked at once."""

_EIGHT = wp.constant(EIGHT)


@no_type_check
@wp.struct
class Box:
    """Two opposite corners [m], in single precision."""

    low: wp.vec3
    high: wp.vec3


_FIND_TOUCHING = """
    const float* side = boxes.data + 48 * (size_t)eight;
#ifdef __clang__  // All eight in one go.
    typedef float Eight __attribute__((ext_vector_type(8)));
    typedef bool EightBits __attribute__((ext_vector_type(8)));
    typedef Eight EightAnywhere __attribute__((aligned(4)));
    const EightAnywhere* sides = reinterpret_cast<const EightAnywhere*>(side);
    const auto touch =
        (sides[0] <= box.high[0]) & (sides[1] <= box.high[1]) & (sides[2] <= box.high[2])
        & (sides[3] >= box.low[0]) & (sides[4] >= box.low[1]) & (sides[5] >= box.low[2]);
    bits = __builtin_bit_cast(unsigned char, __builtin_convertvector(touch, EightBits));
#else
    bits = 0;
    for (int place = 0; place < 8; ++place) {
        bool touch = true;
        for (int axis = 0; axis < 3; ++axis)
            touch = touch && side[8 * axis + place] <= box.high[axis]
                && side[8 * axis + 24 + place] >= box.low[axis];
        bits |= (unsigned)touch << place;
    }
#endif
"""


@no_type_check
@wp.func_native(_FIND_TOUCHING)
def find_touching(box: Box, boxes: wp.array3d(dtype=float), eight: int, bits: wp.ref[wp.uint32]):
    """Set a bit for each box of an eight that touches another."""


_KEEP_STRANGERS = """
    const int* corner = corners.data + 24 * (size_t)eight;
#ifdef __clang__  // All eight in one go.
    typedef int Eight __attribute__((ext_vector_type(8)));
    typedef bool EightBits __attribute__((ext_vector_type(8)));
    typedef Eight EightAnywhere __attribute__((aligned(4)));
    const EightAnywhere* vertex = reinterpret_cast<const EightAnywhere*>(corner);
    const auto strange = (vertex[0] != one) & (vertex[1] != one) & (vertex[2] != one)
        & (vertex[0] != other) & (vertex[1] != other) & (vertex[2] != other);
    bits &= __builtin_bit_cast(unsigned char, __builtin_convertvector(strange, EightBits));
#else
    for (int place = 0; place < 8; ++place) {
        bool strange = true;
        for (int k = place; k < 24; k += 8)
            strange = strange && corner[k] != one && corner[k] != other;
        bits &= ~((unsigned)!strange << place);
    }
#endif
"""


@no_type_check
@wp.func_native(_KEEP_STRANGERS)
def keep_strangers(
    one: int, other: int, corners: wp.array3d(dtype=int), eight: int, bits: wp.ref[wp.uint32]
):
    """Keep the bits of triangles of an eight that have neither of two vertices."""


_TAKE_LOWEST = """
#ifdef __CUDA_ARCH__
    place = __ffs(bits) - 1;
#else
    place = __builtin_ctz(bits);
#endif
    bits &= bits - 1;
"""


@no_type_check
@wp.func_native(_TAKE_LOWEST)
def take_lowest(bits: wp.ref[wp.uint32], place: wp.ref[wp.int32]):
    """Clear the lowest bit that is set, of which there must be one; its place."""


@no_type_check
@wp.func
def box_at(boxes: wp.array3d(dtype=float), eight: int, place: int):
    """One box of an eight."""
    box = Box()
    box.low = wp.vec3(boxes[eight, 0, place], boxes[eight, 1, place], boxes[eight, 2, place])
    box.high = wp.vec3(boxes[eight, 3, place], boxes[eight, 4, place], boxes[eight, 5, place])
    return box


@no_type_check
@wp.func
def put_box(box: Box, boxes: wp.array3d(dtype=float), eight: int, place: int):
    """Write one box of an eight."""
    for axis in range(3):
        boxes[eight, axis, place] = box.low[axis]
        boxes[eight, 3 + axis, place] = box.high[axis]


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
    """The boxes of all triangles and edges, and the boxes around each eight; one thread for each.

    Those of edges are `slack` wider [m]: points are rounded to single precision. `corners` are -1
    where an eight is not full.
    """
    eight = wp.tid()
    margin = wp.vec3(0.0, 0.0, 0.0)
    if eight >= first_edges:
        margin = wp.vec3(slack, slack, slack)
    whole = Box()
    whole.low = wp.vec3(wp.inf, wp.inf, wp.inf)
    whole.high = -whole.low
    for place in range(_EIGHT):
        if corners[eight, 0, place] >= 0:
            a = points[corners[eight, 0, place]]
            b = points[corners[eight, 1, place]]
            c = points[corners[eight, 2, place]]
            box = Box()
            box.low = wp.min(wp.min(a, b), c) - margin
            box.high = wp.max(wp.max(a, b), c) + margin
            put_box(box, boxes, eight, place)
            whole.low = wp.min(whole.low, box.low)
            whole.high = wp.max(whole.high, box.high)
    put_box(whole, around, eight // _EIGHT, eight % _EIGHT)


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
def list_between(
    edges: int,
    faces: int,
    around_faces: Box,
    vertices: wp.array(dtype=wp.vec3d),
    corners: wp.array3d(dtype=int),
    boxes: wp.array3d(dtype=float),
    found: wp.array(dtype=wp.vec2i),
    count: wp.array(dtype=int),
):
    """List the crossings of an eight of edges with an eight of triangles."""
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
            if passes_through(vertices[i], vertices[j], a, b, c):
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
    """List in any order which edge passes through which triangle that has no vertex of it.

    What finds no slot is counted, not listed. What lies in the boxes is tried in double precision.
    One thread for each eight of eights of edges.
    """
    edge_block = first_edges // _EIGHT + wp.tid()
    whole = box_at(around, edge_block, 0)
    for n in range(1, _EIGHT):
        box = box_at(around, edge_block, n)
        whole.low = wp.min(whole.low, box.low)
        whole.high = wp.max(whole.high, box.high)
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
                list_between(
                    _EIGHT * edge_block + edge_place, _EIGHT * block + place, around_faces,
                    vertices, corners, boxes, found, count,
                )  # fmt: skip
