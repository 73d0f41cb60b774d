"""The kernel that carries depth from one camera to another."""

from typing import no_type_check

import warp as wp

FARTHEST = 2147483647
_WIDEST = 32
# Less than half a pixel, so that pictures whose pixels coincide gain nothing.
_REACH = wp.constant(0.49)


@no_type_check
@wp.func
def paint(
    left: float,
    right: float,
    top: float,
    bottom: float,
    value: int,
    width: int,
    height: int,
    nearest: wp.array(dtype=wp.int32),
):
    """Give every pixel centre in a rectangle the value, unless it has a nearer one."""
    first, last = int(wp.max(wp.ceil(left), 0.0)), int(wp.min(wp.ceil(right), float(width)))
    upper, lower = int(wp.max(wp.ceil(top), 0.0)), int(wp.min(wp.ceil(bottom), float(height)))
    last, lower = wp.min(last, first + _WIDEST), wp.min(lower, upper + _WIDEST)
    for y in range(upper, lower):
        for x in range(first, last):
            wp.atomic_min(nearest, y * width + x, value)


@no_type_check
@wp.kernel
def splat(
    counts: wp.array2d(dtype=wp.uint16),
    corners: wp.array2d(dtype=wp.vec2),
    rotation: wp.mat33,
    translation: wp.vec3,
    unit_m: float,
    focal: wp.vec2,
    center: wp.vec2,
    width: int,
    height: int,
    nearest: wp.array(dtype=wp.int32),
    around: wp.array(dtype=wp.int32),
):
    """Paint every measured pixel as the rectangle that it covers in the other picture.

    Two opposite corners of the pixel are carried over at the pixel's depth; all pixel centres
    between them get it, the nearest depth wins. Neighbours on a slanted surface drift apart by a
    fraction of a pixel: `around` has the same rectangles, almost half a pixel larger on every side.
    """
    row, column = wp.tid()
    count = int(counts[row, column])
    if count == 0:
        return
    depth = float(count) * unit_m
    low, high = corners[row, column], corners[row + 1, column + 1]
    one = rotation * wp.vec3(low[0] * depth, low[1] * depth, depth) + translation
    other = rotation * wp.vec3(high[0] * depth, high[1] * depth, depth) + translation
    # What is not a number is not greater either.
    if not (one[2] > 0.0 and other[2] > 0.0):
        return
    value = int(0.5 * (one[2] + other[2]) / unit_m + 0.5)
    if value < 1 or value > 65535:
        return
    u, v = focal[0] * one[0] / one[2] + center[0], focal[1] * one[1] / one[2] + center[1]
    s, t = focal[0] * other[0] / other[2] + center[0], focal[1] * other[1] / other[2] + center[1]
    left, right = wp.min(u, s), wp.max(u, s)
    top, bottom = wp.min(v, t), wp.max(v, t)
    if not (right > -1.0 and left < float(width) and bottom > -1.0 and top < float(height)):
        return
    paint(left, right, top, bottom, value, width, height, nearest)
    paint(
        left - _REACH, right + _REACH, top - _REACH, bottom + _REACH, value, width, height, around
    )
