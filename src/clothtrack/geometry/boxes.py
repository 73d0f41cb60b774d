"""Axis-aligned boxes in blocks of eight that are tested at once, and the order of their items.

`boxes[eight, k, place]` are the lower (k = 0, 1, 2) and the upper corner (k = 3, 4, 5) [m] of the
box at one of the eight places of a block.
"""

from typing import no_type_check

import numpy as np
import warp as wp
from jaxtyping import Float, Float32, Int

wp.set_module_options({"enable_backward": False})

EIGHT = 8
"""Number of boxes that are tested at once."""

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
    """Set a bit for each box of a block that touches a given box."""


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
    """Clear the bits of triangles of a block that contain one of two vertices."""


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
    """Clear the lowest set bit and return its place; at least one bit must be set."""


@no_type_check
@wp.func
def box_at(boxes: wp.array3d(dtype=float), eight: int, place: int):
    """Return one box of a block of eight."""
    box = Box()
    box.low = wp.vec3(boxes[eight, 0, place], boxes[eight, 1, place], boxes[eight, 2, place])
    box.high = wp.vec3(boxes[eight, 3, place], boxes[eight, 4, place], boxes[eight, 5, place])
    return box


@no_type_check
@wp.func
def put_box(box: Box, boxes: wp.array3d(dtype=float), eight: int, place: int):
    """Write one box of a block of eight."""
    for axis in range(3):
        boxes[eight, axis, place] = box.low[axis]
        boxes[eight, 3 + axis, place] = box.high[axis]


@no_type_check
@wp.func
def no_box():
    """Return an empty box, which touches no finite box and does not enlarge others."""
    box = Box()
    box.low = wp.vec3(wp.inf, wp.inf, wp.inf)
    box.high = -box.low
    return box


@no_type_check
@wp.func
def join(one: Box, other: Box):
    """Return the box around two; NaN corners are ignored."""
    box = Box()
    box.low = wp.min(one.low, other.low)
    box.high = wp.max(one.high, other.high)
    return box


@no_type_check
@wp.func
def around_eight(boxes: wp.array3d(dtype=float), eight: int):
    """Return the box around a block of eight boxes."""
    whole = box_at(boxes, eight, 0)
    for place in range(1, _EIGHT):
        whole = join(whole, box_at(boxes, eight, place))
    return whole


def blocks(count: int, size: int) -> int:
    """Return the number of blocks of `size` needed for `count` items."""
    return -(-count // size)


def along_curve(points: Float[np.ndarray, "points 3"]) -> Int[np.ndarray, " points"]:
    """Return the order of points along a Morton curve.

    Ten bits of each coordinate are spread with two zeros between them, then the three coordinates
    are interleaved.
    """
    above = points - points.min(axis=0)
    code = (above * (1023.0 / max(float(above.max()), 1e-30))).astype(np.int64)
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        code = (code | code << shift) & mask
    return np.argsort(code @ (1, 2, 4), kind="stable")


def no_boxes(*shape: int) -> Float32[np.ndarray, "..."]:
    """Return boxes that touch nothing, not even an infinite box, because their corners are NaN."""
    return np.full((*shape, 6, EIGHT), np.nan, np.float32)
