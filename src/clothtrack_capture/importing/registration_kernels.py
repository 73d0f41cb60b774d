"""The kernel that maps depth from one camera to another."""

from typing import no_type_check

import warp as wp

# Greater than every painted value; its low 16 bits are 0, which means "no depth".
FARTHEST = 0x7FFF0000
# Added where a rectangle only reaches a pixel, so that every rectangle that covers it wins.
_BEHIND = wp.constant(0x10000)
_WIDEST = 32
# Less than half a pixel, so that pictures whose pixels coincide gain nothing.
_REACH = wp.constant(0.49)


@no_type_check
@wp.func
def _splat_pixel(
    count: float,
    low: wp.vec3,
    high: wp.vec3,
    shift: wp.vec3,
    width: int,
    height: int,
    painted: wp.array(dtype=wp.int32),
):
    """Paint one pixel as the rectangle between two opposite corners, projected at its depth."""
    one, other = count * low + shift, count * high + shift
    # This form of the comparison also rejects NaN.
    if not (one[2] > 0.0 and other[2] > 0.0):
        return
    value = int(0.5 * (one[2] + other[2]) + 0.5)
    if value < 1 or value > 65535:
        return
    near, far = 1.0 / one[2], 1.0 / other[2]
    u, v, s, t = one[0] * near, one[1] * near, other[0] * far, other[1] * far
    left, right, top, bottom = wp.min(u, s), wp.max(u, s), wp.min(v, t), wp.max(v, t)
    if not (right > -1.0 and left < float(width) and bottom > -1.0 and top < float(height)):
        return
    # Clip to the picture, because larger coordinates may overflow an integer.
    left, right = wp.max(left, -1.0), wp.min(right, float(width))
    top, bottom = wp.max(top, -1.0), wp.min(bottom, float(height))
    # From here on the rectangle and its extension are in whole pixels.
    first, last = int(wp.ceil(left)), int(wp.ceil(right))
    upper, lower = int(wp.ceil(top)), int(wp.ceil(bottom))
    start = wp.max(int(wp.ceil(left - _REACH)), 0)
    stop = wp.min(wp.min(int(wp.ceil(right + _REACH)), width), start + _WIDEST)
    above = wp.max(int(wp.ceil(top - _REACH)), 0)
    below = wp.min(wp.min(int(wp.ceil(bottom + _REACH)), height), above + _WIDEST)
    behind = value + _BEHIND
    y = above
    while y < below:
        covered = value
        if y < upper or y >= lower:
            covered = behind
        x = start
        while x < stop:
            wp.atomic_min(
                painted, y * width + x, wp.where(x >= first and x < last, covered, behind)
            )
            x += 1
        y += 1


@no_type_check
@wp.kernel
def splat(
    counts: wp.array2d(dtype=wp.uint16),
    corners: wp.array2d(dtype=wp.vec3),
    shift: wp.vec3,
    width: int,
    height: int,
    painted: wp.array(dtype=wp.int32),
):
    """Paint every measured pixel of a row; the low 16 bits of painted values are the depth.

    Args:
        counts: depth [units].
        corners: rays through the pixel corners, times rotation and the other camera's intrinsics.
        shift: translation to the other camera, times its intrinsics [units].
        width: width of the other picture [pixels].
        height: height of the other picture [pixels].
        painted: pixels of the other picture, initially FARTHEST.
    """
    row = wp.tid()
    for column in range(counts.shape[1]):
        count = int(counts[row, column])
        if count > 0:
            _splat_pixel(
                float(count),
                corners[row, column],
                corners[row + 1, column + 1],
                shift,
                width,
                height,
                painted,
            )
