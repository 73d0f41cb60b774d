"""Warp kernel that finds the face nearest to each point in the tree of a triangle mesh."""

from typing import no_type_check

import warp as wp

wp.set_module_options({"enable_backward": False})

_ANYWHERE = wp.constant(1.0e10)
"""Search distance for faces [m]; its square is finite in single precision."""


@no_type_check
@wp.kernel
def find_nearest_face(
    mesh: wp.uint64, points: wp.array(dtype=wp.vec3), faces: wp.array(dtype=wp.int32)
):
    """Find the face that is nearest to each point."""
    point = wp.tid()
    faces[point] = wp.mesh_query_point_no_sign(mesh, points[point], _ANYWHERE).face
