"""Cells of space in which contact looks for what is near: numbering, and the block around a point.

Both contacts, of vertices with triangles and of edges with edges, sort what may be touched into
these cells and then look through the rows of a block.
"""

from typing import no_type_check

import warp as wp

wp.set_module_options({"enable_backward": False})

CELLS_X, CELLS_Y, CELLS_Z = 32, 32, 16
"""Cells of each environment; space repeats beyond them, which costs time but no contact."""

CELLS_PER_ENVIRONMENT = CELLS_X * CELLS_Y * CELLS_Z

_MASK_X = wp.constant(CELLS_X - 1)
_MASK_Y = wp.constant(CELLS_Y - 1)
_MASK_Z = wp.constant(CELLS_Z - 1)
_WIDTH = wp.constant(CELLS_X)
_LAYER = wp.constant(CELLS_X * CELLS_Y)
_CELLS = wp.constant(CELLS_PER_ENVIRONMENT)
_HALF = wp.constant(CELLS_X // 2)
_FARTHEST = wp.constant(1.0e6)
_NOT_NEGATIVE = wp.constant(0x7FFFFFFF)


@no_type_check
@wp.func
def nth(number: int):
    """The number, which is not negative: a compiler that knows need not ask at every access."""
    return number & _NOT_NEGATIVE


@no_type_check
@wp.struct
class Walk:
    """A walk through balls: where it is, where to ask on, and which between the two touch."""

    place: wp.int32
    asked: wp.int32
    waiting: wp.uint32


_NEXT_TOUCHING = """
    const float* ball = reinterpret_cast<const float*>(balls.data);
    const float x = one[0], y = one[1], z = one[2], radius = one[3];
    while (walk.waiting == 0 && walk.asked < end) {
        const int begin = walk.asked;
        walk.asked = end - begin < 32 ? end : begin + 32;
        int n = begin;
#ifdef __clang__  // Four at a time; the loop after it is the same for what is left.
        typedef float Four __attribute__((ext_vector_type(4)));
        typedef int FourBits __attribute__((ext_vector_type(4)));
        typedef Four FourAnywhere __attribute__((aligned(4)));
        FourBits bits = {1, 2, 4, 8}, found = 0;
        for (; n + 4 <= walk.asked; n += 4, bits <<= 4) {
            const FourAnywhere* four = reinterpret_cast<const FourAnywhere*>(ball + 4 * (size_t)n);
            const Four a = four[0], b = four[1], c = four[2], d = four[3];
            const Four ab = __builtin_shufflevector(a, b, 0, 4, 1, 5);
            const Four cd = __builtin_shufflevector(c, d, 0, 4, 1, 5);
            const Four ab_end = __builtin_shufflevector(a, b, 2, 6, 3, 7);
            const Four cd_end = __builtin_shufflevector(c, d, 2, 6, 3, 7);
            const Four across_x = __builtin_shufflevector(ab, cd, 0, 1, 4, 5) - x;
            const Four across_y = __builtin_shufflevector(ab, cd, 2, 3, 6, 7) - y;
            const Four across_z = __builtin_shufflevector(ab_end, cd_end, 0, 1, 4, 5) - z;
            const Four radii = __builtin_shufflevector(ab_end, cd_end, 2, 3, 6, 7) + radius;
            const FourBits touching =
                across_x * across_x + across_y * across_y + across_z * across_z <= radii * radii;
            found |= touching & bits;
        }
        walk.waiting = __builtin_reduce_or(found);
#endif
        for (; n < walk.asked; ++n) {
            const float across_x = ball[4 * n] - x, across_y = ball[4 * n + 1] - y;
            const float across_z = ball[4 * n + 2] - z, radii = ball[4 * n + 3] + radius;
            const unsigned touching =
                across_x * across_x + across_y * across_y + across_z * across_z <= radii * radii;
            walk.waiting |= touching << (n - begin);
        }
        walk.place = begin - 1;
    }
    if (walk.waiting == 0) {
        walk.place = end;
        return;
    }
#ifdef __CUDA_ARCH__
    const int on = __ffs(walk.waiting);
#else
    const int on = __builtin_ctz(walk.waiting) + 1;
#endif
    walk.place += on;
    walk.waiting = walk.waiting >> (on - 1) >> 1;
"""


@no_type_check
@wp.func_native(_NEXT_TOUCHING)
def next_touching(one: wp.vec4, balls: wp.array(dtype=wp.vec4), end: int, walk: wp.ref[Walk]):
    """Walk on to the next ball (centre, radius [m]) that touches one, or to `end`.

    A new walk is `asked` where to begin. Balls are asked thirty-two at a time; `waiting` has a bit
    for each that touches after `place`. In C++, because there four can be asked at once. How it
    rounds is the compiler's business: balls that must be found are a thousandth too large.
    """


@no_type_check
@wp.func
def cell_along(value: wp.float32, cells_per_metre: wp.float32):
    """Number of the cell along one axis, before space repeats; finite for whatever exploded.

    The origin, around which cloths tend to lie, is in the middle of what repeats along x.
    """
    return int(wp.floor(wp.clamp(value * cells_per_metre, -_FARTHEST, _FARTHEST))) + _HALF


@no_type_check
@wp.func
def cell_of(environment: int, point: wp.vec3, cells_per_metre: float):
    """Number of the cell of one environment that a point lies in."""
    x = cell_along(point[0], cells_per_metre) & _MASK_X
    y = cell_along(point[1], cells_per_metre) & _MASK_Y
    z = cell_along(point[2], cells_per_metre) & _MASK_Z
    return environment * _CELLS + z * _LAYER + y * _WIDTH + x


@no_type_check
@wp.struct
class Block:
    """Cells that a cube reaches into: columns `left` to `right` of rows y0..y1 in layers z0..z1."""

    left: wp.int32
    right: wp.int32
    y0: wp.int32
    y1: wp.int32
    z0: wp.int32
    z1: wp.int32


@no_type_check
@wp.func
def block_around(point: wp.vec3, reach: float, cells_per_metre: float):
    """Cells that hold everything within a reach [m] of a point, each of them once.

    Cells side by side are one run; where space repeats between them, it is the whole row.
    """
    block = Block()
    x0 = cell_along(point[0] - reach, cells_per_metre)
    x1 = wp.min(cell_along(point[0] + reach, cells_per_metre), x0 + _MASK_X)
    block.y0 = cell_along(point[1] - reach, cells_per_metre)
    block.y1 = wp.min(cell_along(point[1] + reach, cells_per_metre), block.y0 + _MASK_Y)
    block.z0 = cell_along(point[2] - reach, cells_per_metre)
    block.z1 = wp.min(cell_along(point[2] + reach, cells_per_metre), block.z0 + _MASK_Z)
    block.left = x0 & _MASK_X
    block.right = x1 & _MASK_X
    if block.right < block.left:
        block.left = 0
        block.right = _MASK_X
    return block


@no_type_check
@wp.func
def row_at(environment: int, y: int, z: int):
    """Number of the first cell of a row."""
    return environment * _CELLS + (z & _MASK_Z) * _LAYER + (y & _MASK_Y) * _WIDTH
