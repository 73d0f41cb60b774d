"""Laws of the z-buffer: against ray casting, at the near plane, and for what counts as visible."""

import numpy as np
import pytest

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer, visible_vertices

DOWN = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1.0], [0, 0, 0, 1]])


def camera(width=64, height=48, focal=60.0, pose=DOWN, **options):
    center = options.pop("center", ((width - 1) / 2, (height - 1) / 2))
    return Camera("top", width, height, focal, focal * 1.1, *center, pose)


def grid(count, size, height=0.0, offset=(0.0, 0.0)):
    side = np.linspace(-size / 2, size / 2, count)
    x, y = np.meshgrid(side + offset[0], side + offset[1], indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), np.full(count * count, float(height))], 1)
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + count, corner + 1], 1),
            np.stack([corner + 1, corner + count, corner + count + 1], 1),
        ]
    )
    return vertices, faces


def cast_rays(vertices, faces, view):
    """Depth and face by testing every ray against every triangle, in double precision."""
    local = view.camera_from_world_points(vertices)
    columns, rows = np.meshgrid(np.arange(view.width), np.arange(view.height))
    rays = np.stack([(columns - view.cx) / view.fx, (rows - view.cy) / view.fy], -1)
    rays = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], -1)
    depth = np.full(rays.shape[:2], np.inf)
    index = np.full(rays.shape[:2], -1)
    margin = np.full(rays.shape[:2], np.inf)
    for number, (a, b, c) in enumerate(local[faces]):
        determinant = a @ np.cross(b, c)
        weights = np.stack([rays @ np.cross(b, c), rays @ np.cross(c, a), rays @ np.cross(a, b)])
        weights = weights / determinant
        with np.errstate(divide="ignore"):
            z = 1 / weights.sum(0)
        margin = np.minimum(margin, np.abs(weights * z).min(0))
        hit = (weights >= 0).all(0) & (z > 1e-3) & (z < depth)
        depth[hit], index[hit] = z[hit], number
    return depth, index, margin


def random_pose(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = q * np.sign(np.linalg.det(q))
    pose[:3, 3] = rng.normal(size=3)
    return pose


@pytest.mark.parametrize("seed", range(4))
def test_rasterizer_agrees_with_ray_casting(seed):
    rng = np.random.default_rng(seed)
    view = camera(pose=random_pose(rng), center=(20.3, 31.2))
    centers = rng.uniform([-0.4, -0.4, 0.5], [0.4, 0.4, 2.0], size=(40, 1, 3))
    local = centers + rng.normal(scale=0.15, size=(40, 3, 3))
    vertices = (local @ view.world_from_camera[:3, :3].T + view.position).reshape(-1, 3)
    faces = np.arange(120).reshape(-1, 3)
    seen = Rasterizer(faces, view).render(vertices)
    depth, index, margin = cast_rays(vertices, faces, view)
    sure = margin > 2e-3
    assert sure.mean() > 0.7
    np.testing.assert_array_equal(seen.faces[sure], index[sure])
    assert (index[sure] >= 0).mean() > 0.2
    np.testing.assert_allclose(seen.depth[sure], depth[sure], rtol=1e-5)


def test_triangle_that_reaches_behind_the_camera_is_drawn_where_it_is_in_front():
    view = camera()
    rng = np.random.default_rng(3)
    local = rng.normal(loc=(0, 0, 0.4), size=(30, 3, 3))
    assert ((local[..., 2] < 0).any(1) & (local[..., 2] > 0).any(1)).sum() > 5
    vertices = (local @ view.world_from_camera[:3, :3].T + view.position).reshape(-1, 3)
    faces = np.arange(90).reshape(-1, 3)
    seen = Rasterizer(faces, view).render(vertices)
    depth, index, margin = cast_rays(vertices, faces, view)
    sure = margin > 3e-3
    assert sure.mean() > 0.5
    np.testing.assert_array_equal(seen.faces[sure], index[sure])
    np.testing.assert_allclose(seen.depth[sure], depth[sure], rtol=1e-3)


@pytest.mark.parametrize("offset", [(0.1, 0.0), (0.45, -0.3), (5.0, 0.0)])
@pytest.mark.parametrize("height", [0.0, 0.9, 0.9995, 2.0])
def test_the_window_of_a_mesh_holds_all_that_is_drawn(offset, height):
    vertices, faces = grid(7, 0.3, height, offset)
    vertices[:, 2] += 0.05 * vertices[:, 0]
    rasterizer = Rasterizer(faces, camera())
    window = rasterizer.window(vertices)
    drawn = rasterizer.render(vertices).faces
    np.testing.assert_array_equal(rasterizer.faces_within(vertices, window), drawn[window])
    drawn[window] = -1
    assert (drawn == -1).all()


def test_a_closed_grid_has_no_holes_even_with_pixel_centers_on_its_edges():
    view = Camera("top", 41, 41, 40.0, 40.0, 20.0, 20.0, DOWN)
    vertices, faces = grid(21, 1.0)  # every edge lies on a line of pixel centers or between two
    seen = Rasterizer(faces, view).render(vertices)
    assert (seen.faces >= 0).all()
    np.testing.assert_allclose(seen.depth, 1.0, rtol=1e-6)


def test_upper_layer_hides_the_lower_one_and_the_last_face_is_not_always_visible():
    lower, faces = grid(12, 0.4)
    upper, _ = grid(12, 0.4, height=0.01)
    both = np.concatenate([upper, lower])
    both_faces = np.concatenate([faces, faces + len(upper)])
    inner = np.abs(lower[:, :2]).max(1) < 0.15
    seen = visible_vertices(both, both_faces, [camera(320, 240, 250.0)])
    assert seen[: len(upper)].all()
    assert not seen[len(upper) :][inner].any()


def test_thin_layers_need_a_tolerance_below_their_distance():
    """A hidden vertex whose own face shows through a gap counts only within the tolerance."""
    lower, faces = grid(9, 0.4)
    upper, _ = grid(9, 0.4, height=0.006, offset=(0.02, 0.0))
    both = np.concatenate([upper, lower])
    both_faces = np.concatenate([faces, faces + len(upper)])
    check = [
        visible_vertices(both, both_faces, [camera(320, 240, 250.0)], tolerance_m=tolerance)
        for tolerance in (0.003, 0.01)
    ]
    column = np.isclose(lower[:, 0], -0.15)  # under the upper layer, but their faces peep out
    assert not check[0][len(upper) :][column].any()
    assert check[1][len(upper) :][column].any()
