"""The table under one depth picture: fitted however the camera is tilted, or refused."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.reconstruction.depth_input import from_depth

FOCAL, HEIGHT_M, CLOTH_M, SIDE_M = 300.0, 0.9, 0.012, 0.2


def camera(tilt_deg, *, azimuth=0.7, principal_point=(159.5, 119.5)):
    """A camera that looks at the world's origin from so far beside straight above."""
    axis = np.radians(tilt_deg) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ cv2.Rodrigues(axis)[0]
    pose[:3, 3] = -pose[:3, 2] * HEIGHT_M
    return Camera("top", 320, 240, FOCAL, FOCAL, *principal_point, pose)


def plane_hit(view, height_m):
    """Depth [m] of a horizontal plane, and where it is hit [m]."""
    ones = np.ones((view.height, view.width))
    aligned = replace(view, world_from_camera=np.eye(4))
    rays = aligned.back_project(ones) @ view.world_from_camera[:3, :3].T
    depth = (height_m - view.position[2]) / rays[:, 2]
    points = view.position + depth[:, None] * rays
    return depth.reshape(ones.shape), points.reshape(*ones.shape, 3)


def picture(view, *, noise_m=0.0, step_m=0.0, holes=0.0):
    """A square cloth on a table, as a sensor with noise, steps and holes; and where it is."""
    rng = np.random.default_rng(0)
    depth, _ = plane_hit(view, 0.0)
    top, points = plane_hit(view, CLOTH_M)
    cloth = (np.abs(points[..., :2]) < SIDE_M / 2).all(axis=-1)
    depth = np.where(cloth, top, depth)
    depth = depth + noise_m * rng.standard_normal(depth.shape)
    if step_m:
        depth = np.rint(depth / step_m) * step_m
    return np.where(rng.random(depth.shape) < holes, 0.0, depth), cloth


def mask_file(folder, cloth):
    """A picture of where the cloth is."""
    path = folder / "mask.png"
    cv2.imwrite(str(path), 255 * cloth.astype(np.uint8))
    return path


def tilt_between(one, other):
    """Angle [degrees] between two cameras' ideas of up."""
    cosine = one.world_from_camera[2, :3] @ other.world_from_camera[2, :3]
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


@pytest.mark.parametrize("tilt_deg", [0.0, 25.0, 40.0])
@pytest.mark.parametrize("masked", [True, False])
def test_a_tilted_camera_is_placed_over_its_table(tilt_deg, masked, tmp_path):
    view = camera(tilt_deg)
    depth, cloth = picture(view)
    seen = from_depth(depth, "it", mask=mask_file(tmp_path, cloth) if masked else None, focal=FOCAL)
    assert seen.table_source == "fitted"
    assert seen.table_residual_m < 1e-6
    assert tilt_between(seen.camera, view) < 1e-3
    assert seen.camera.position[2] == pytest.approx(view.position[2], abs=1e-6)
    points = seen.camera.back_project(seen.depth_m, seen.mask)
    np.testing.assert_allclose(points[:, 2], CLOTH_M, atol=1e-6)
    area = cv2.contourArea(cv2.convexHull(points[:, :2].astype(np.float32)))
    assert area == pytest.approx(SIDE_M**2, rel=0.08)


@pytest.mark.parametrize("tilt_deg", [0.0, 35.0])
def test_noise_steps_and_holes_leave_the_table_where_it_is(tilt_deg, tmp_path):
    view = camera(tilt_deg)
    depth, cloth = picture(view, noise_m=0.002, step_m=0.003, holes=0.3)
    seen = from_depth(depth, "it", mask=mask_file(tmp_path, cloth), focal=FOCAL)
    assert 0.001 < seen.table_residual_m < 0.004
    assert tilt_between(seen.camera, view) < 0.15
    assert seen.camera.position[2] == pytest.approx(view.position[2], abs=0.001)


def test_without_a_table_the_camera_is_assumed_to_look_straight_down(tmp_path):
    depth, cloth = picture(camera(10.0))
    named = from_depth(depth, "it", focal=FOCAL, table_distance_m=0.95)
    np.testing.assert_allclose(named.camera.position, (0.0, 0.0, 0.95))
    depth[~cloth] = 0.0
    bare = from_depth(depth, "it", mask=mask_file(tmp_path, cloth), focal=FOCAL)
    for seen in (named, bare):
        assert (seen.table_source, seen.table_residual_m) == ("assumed", None)
        np.testing.assert_allclose(seen.camera.world_from_camera[2, :3], (0, 0, -1))


def ball(view):
    columns, rows = np.meshgrid(np.arange(view.width), np.arange(view.height))
    return 0.5 + 0.6 * np.hypot((columns - 160) / 160, (rows - 120) / 120)


def two_tables(view):
    low, _ = plane_hit(view, 0.0)
    high, _ = plane_hit(view, 0.3)
    return np.where(np.arange(view.width) < 160, low, high)


@pytest.mark.parametrize(
    ("scene", "told"), [(ball, "no plane dominates"), (two_tables, "two planes")]
)
def test_what_shows_no_table_is_refused(scene, told):
    with pytest.raises(InvalidRecordingError, match=f"heap.png: {told}.*--table-distance"):
        from_depth(scene(camera(3.0)), "heap.png", focal=FOCAL)
