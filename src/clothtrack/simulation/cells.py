"""Cells of space: which are near a point, and in which order."""

from typing import no_type_check

import warp as wp

wp.set_module_options({"enable_backward": False})

CELLS_X, CELLS_Y, CELLS_Z = 32, 32, 16
"""Cells along each axis, beyond which space repeats."""

_MASK_X = wp.constant(CELLS_X - 1)
_MASK_Y = wp.constant(CELLS_Y - 1)
_MASK_Z = wp.constant(CELLS_Z - 1)
_WIDTH = wp.constant(CELLS_X)
_LAYER = wp.constant(CELLS_X * CELLS_Y)
_HALF = wp.constant(CELLS_X // 2)
_FARTHEST = wp.constant(1.0e6)
_NOT_NEGATIVE = wp.constant(0x7FFFFFFF)


@no_type_check
@wp.func
def nth(number: int):
    """The number, which is not negative: a compiler that knows need not ask at every access."""
    return number & _NOT_NEGATIVE


@no_type_check
@wp.func
def cell_along(value: wp.float32, cells_per_metre: wp.float32):
    """Number of the cell along one axis, before space repeats; finite for whatever exploded.

    The origin, around which cloths tend to lie, is in the middle of what repeats along x.
    """
    return int(wp.floor(wp.clamp(value * cells_per_metre, -_FARTHEST, _FARTHEST))) + _HALF


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
def place_in(block: Block, point: wp.vec3, cells_per_metre: float):
    """Place of a point's cell in the order of a block's cells; -1: it is not in the block."""
    x = cell_along(point[0], cells_per_metre) & _MASK_X
    y = (cell_along(point[1], cells_per_metre) - block.y0) & _MASK_Y
    z = (cell_along(point[2], cells_per_metre) - block.z0) & _MASK_Z
    if x < block.left or x > block.right or y > block.y1 - block.y0 or z > block.z1 - block.z0:
        return -1
    return z * _LAYER + y * _WIDTH + x
