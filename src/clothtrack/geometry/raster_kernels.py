"""Warp kernels of the z-buffer: triangles to pixels, pixels to visible vertices.

Triangles are rasterized in homogeneous form. For a triangle with corners a, b, c in the camera's
frame and the viewing ray d of a pixel, the three triple products (a x b).d, (b x c).d, (c x a).d
have the same sign exactly if the ray's line meets the triangle. The inverse depth there is
n.d / n.a with n the triangle's normal. All four are linear in the pixel coordinates, so the inner
loop only adds, and a triangle that reaches behind the camera needs no clipping (M. Olano and
T. Greer, "Triangle scan conversion using 2D homogeneous coordinates", 1997,
doi:10.1145/258694.258723).

A pixel is one 64-bit number with the depth's bits above the face's index. The smallest one wins,
for any order of the threads, so that CPU and GPU agree and results are reproducible.
"""

# Warp needs `float(0.0)` for a variable that changes in a loop, and kernels take many arrays.

from typing import no_type_check

import warp as wp

EMPTY_PIXEL = 0xFFFFFFFFFFFFFFFF
"""Value of a pixel that no face covers."""

STRIP_PIXELS = 64
"""Pixels per thread of `mark_hit_vertices`."""

_EMPTY = wp.constant(wp.uint64(EMPTY_PIXEL))
_STRIP = wp.constant(STRIP_PIXELS)


@no_type_check
@wp.struct
class RasterCamera:
    """Pinhole camera for kernels: image size [pixels], intrinsics [pixels], pose, near [m]."""

    width: wp.int32
    height: wp.int32
    fx: wp.float32
    fy: wp.float32
    cx: wp.float32
    cy: wp.float32
    camera_from_world: wp.mat33
    position: wp.vec3
    near: wp.float32


@no_type_check
@wp.func
def _to_camera(camera: RasterCamera, point: wp.vec3):
    return camera.camera_from_world * (point - camera.position)


@no_type_check
@wp.func
def _triple(a: wp.vec3, b: wp.vec3, c: wp.vec3):
    return wp.dot(wp.cross(a, b), c)


@no_type_check
@wp.kernel(enable_backward=False)
def draw_faces(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    camera: RasterCamera,
    pixels: wp.array(dtype=wp.uint64),
):
    """Write each face's depth and index to the pixels whose center it covers; the nearest wins."""
    face = wp.tid()
    corners = faces[face]
    a = _to_camera(camera, vertices[corners[0]])
    b = _to_camera(camera, vertices[corners[1]])
    c = _to_camera(camera, vertices[corners[2]])
    if wp.max(a[2], wp.max(b[2], c[2])) < camera.near:
        return

    left = float(0.0)
    top = float(0.0)
    right = float(camera.width - 1)
    bottom = float(camera.height - 1)
    if wp.min(a[2], wp.min(b[2], c[2])) >= camera.near:
        ax = camera.fx * a[0] / a[2] + camera.cx
        bx = camera.fx * b[0] / b[2] + camera.cx
        cx = camera.fx * c[0] / c[2] + camera.cx
        ay = camera.fy * a[1] / a[2] + camera.cy
        by = camera.fy * b[1] / b[2] + camera.cy
        cy = camera.fy * c[1] / c[2] + camera.cy
        left = wp.max(left, wp.ceil(wp.min(ax, wp.min(bx, cx)) - 1.0e-3))
        right = wp.min(right, wp.floor(wp.max(ax, wp.max(bx, cx)) + 1.0e-3))
        top = wp.max(top, wp.ceil(wp.min(ay, wp.min(by, cy)) - 1.0e-3))
        bottom = wp.min(bottom, wp.floor(wp.max(ay, wp.max(by, cy)) + 1.0e-3))
    # Use this test instead of "left > right", so that a face with NaN is not drawn.
    if not (left <= right and top <= bottom):
        return

    normal = wp.cross(b - a, c - a)
    plane = wp.dot(normal, a)
    if plane == 0.0:
        return
    turn = wp.sign(plane)
    normal = turn * normal
    plane = turn * plane
    ab = turn * wp.cross(a, b)
    bc = turn * wp.cross(b, c)
    ca = turn * wp.cross(c, a)
    # The ray of the first pixel. Moving the corners along it does not change the triple products
    # but makes the numbers small, which keeps the digits that decide on which side a pixel lies.
    ray = wp.vec3((left - camera.cx) / camera.fx, (top - camera.cy) / camera.fy, 1.0)
    near_a = a - a[2] * ray
    near_b = b - a[2] * ray
    near_c = c - a[2] * ray
    e0 = turn * _triple(near_a, near_b, ray)
    e1 = turn * _triple(near_b, near_c, ray)
    e2 = turn * _triple(near_c, near_a, ray)
    inverse = wp.dot(normal, ray) / plane
    e0x = ab[0] / camera.fx
    e1x = bc[0] / camera.fx
    e2x = ca[0] / camera.fx
    inverse_x = normal[0] / camera.fx / plane
    e0y = ab[1] / camera.fy
    e1y = bc[1] / camera.fy
    e2y = ca[1] / camera.fy
    inverse_y = normal[1] / camera.fy / plane
    # A pixel center on an edge belongs to both faces; a thousandth of a pixel closes the seams.
    s0 = 1.0e-3 * (wp.abs(e0x) + wp.abs(e0y))
    s1 = 1.0e-3 * (wp.abs(e1x) + wp.abs(e1y))
    s2 = 1.0e-3 * (wp.abs(e2x) + wp.abs(e2y))
    largest_inverse = 1.0 / camera.near
    rows = int(bottom) - int(top) + 1
    columns = int(right) - int(left) + 1
    for row in range(rows):
        y = float(row)
        f0 = e0 + y * e0y + s0
        f1 = e1 + y * e1y + s1
        f2 = e2 + y * e2y + s2
        inverse_row = inverse + y * inverse_y
        start = (int(top) + row) * camera.width + int(left)
        for column in range(columns):
            x = float(column)
            if f0 + x * e0x >= 0.0 and f1 + x * e1x >= 0.0 and f2 + x * e2x >= 0.0:
                inverse_depth = inverse_row + x * inverse_x
                if inverse_depth > 0.0 and inverse_depth <= largest_inverse:
                    bits = wp.cast(1.0 / inverse_depth, wp.uint32)
                    key = (wp.uint64(bits) << wp.uint64(32)) | wp.uint64(face)
                    wp.atomic_min(pixels, start + column, key)


@no_type_check
@wp.kernel(enable_backward=False)
def unpack_pixels(
    pixels: wp.array(dtype=wp.uint64),
    depth: wp.array(dtype=wp.float32),
    faces: wp.array(dtype=wp.int32),
):
    """Split each pixel into its depth [m] (infinite for background) and face (-1)."""
    pixel = wp.tid()
    key = pixels[pixel]
    if key == _EMPTY:
        depth[pixel] = wp.inf
        faces[pixel] = -1
    else:
        depth[pixel] = wp.cast(wp.uint32(key >> wp.uint64(32)), wp.float32)
        faces[pixel] = wp.int32(key & wp.uint64(0xFFFFFFFF))


@no_type_check
@wp.kernel(enable_backward=False)
def mark_hit_vertices(
    pixels: wp.array(dtype=wp.uint64),
    faces: wp.array(dtype=wp.vec3i),
    hit: wp.array(dtype=wp.bool),
):
    """Mark the corners of every face that a pixel shows, with one thread per strip of pixels."""
    start = wp.tid() * _STRIP
    last_face = int(-1)
    for pixel in range(start, wp.min(start + _STRIP, pixels.shape[0])):
        key = pixels[pixel]
        if key != _EMPTY:
            face = wp.int32(key & wp.uint64(0xFFFFFFFF))
            if face != last_face:
                corners = faces[face]
                hit[corners[0]] = True
                hit[corners[1]] = True
                hit[corners[2]] = True
                last_face = face


@no_type_check
@wp.kernel(enable_backward=False)
def mark_visible_vertices(
    vertices: wp.array(dtype=wp.vec3),
    hit: wp.array(dtype=wp.bool),
    camera: RasterCamera,
    pixels: wp.array(dtype=wp.uint64),
    tolerance: wp.float32,
    visible: wp.array(dtype=wp.bool),
):
    """Mark hit vertices that are no deeper than the surface around them, plus a tolerance [m].

    The surface around a vertex is the deepest of the (at most four) covered pixels whose centers
    surround its projection.
    """
    vertex = wp.tid()
    if not hit[vertex]:
        return
    point = _to_camera(camera, vertices[vertex])
    if not point[2] >= camera.near:
        return
    x = camera.fx * point[0] / point[2] + camera.cx
    y = camera.fy * point[1] / point[2] + camera.cy
    inside_x = x >= -0.5 and x < float(camera.width) - 0.5
    inside_y = y >= -0.5 and y < float(camera.height) - 0.5
    if not (inside_x and inside_y):
        return
    left = int(wp.floor(x))
    top = int(wp.floor(y))
    deepest = float(-1.0)
    for row in range(wp.max(top, 0), wp.min(top + 2, camera.height)):
        for column in range(wp.max(left, 0), wp.min(left + 2, camera.width)):
            key = pixels[row * camera.width + column]
            if key != _EMPTY:
                depth = wp.cast(wp.uint32(key >> wp.uint64(32)), wp.float32)
                deepest = wp.max(deepest, depth)
    if deepest < 0.0 or point[2] <= deepest + tolerance:
        visible[vertex] = True
