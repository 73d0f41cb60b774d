from dataclasses import replace

import numpy as np

from clothtrack.report.evidence import (
    cloud_picture,
    has_picture,
    observed_points,
    thinned,
    view_picture,
)
from clothtrack.report.viewpoint import look_at

NOTHING = np.empty((0, 3))


def test_thinning_keeps_points_and_their_order(rng):
    points = rng.normal(size=(1000, 3))
    kept = thinned(points, 100)
    assert len(kept) == 100
    places = [int(np.flatnonzero((points == point).all(axis=1))[0]) for point in kept]
    assert places == sorted(set(places))
    assert thinned(points, 1000) is points


def test_a_point_is_drawn_where_the_camera_sees_it():
    camera = look_at(np.array([0.0, 0.0, 1.0]), np.zeros(3), width=80, height=60)
    point = np.array([[0.1, 0.05, 0.0]])
    image = cloud_picture(np.concatenate([point, [[0.0, 0.0, 2.0]]]), camera)
    rows, columns = np.nonzero((image != image[0, 0]).any(axis=2))
    pixel, _ = camera.project(point)
    np.testing.assert_allclose((columns.mean() - 0.5, rows.mean() - 0.5), pixel[0], atol=0.51)
    assert len(rows) == 4


def test_colour_is_preferred_to_depth_and_depth_to_points(two_cameras):
    camera, frame = two_cameras.cameras[0].resized(80), two_cameras.frames[0]
    middle = (30, 40)
    colored = view_picture(two_cameras, frame, camera, NOTHING)[middle]
    assert colored[0] > colored[2] + 50
    grey = view_picture(two_cameras, replace(frame, color={}), camera, NOTHING)[middle]
    assert grey[0] == grey[2] > 0
    bare = replace(frame, color={}, depth={})
    paper = view_picture(two_cameras, bare, camera, NOTHING)
    assert (paper == paper[0, 0]).all()
    assert has_picture(frame, camera)
    assert not has_picture(bare, camera)


def test_a_frame_that_cannot_be_read_costs_the_picture_only(two_cameras, tmp_path, caplog):
    camera = two_cameras.cameras[0]
    missing = {camera.name: tmp_path / "gone.png"}
    frame = replace(two_cameras.frames[0], color=missing, depth=missing, mask={})
    assert view_picture(two_cameras, frame, camera, NOTHING).shape == (120, 160, 3)
    assert len(observed_points(two_cameras, frame)) == 0
    assert caplog.text.count("gone.png") == 2


def test_observed_points_lie_on_the_cloth(two_cameras, tracked):
    points = observed_points(two_cameras, two_cameras.frames[0])
    nearest = np.linalg.norm(points[:, None] - tracked.positions[0][None], axis=2).min(axis=1)
    assert len(points) > 300
    assert nearest.max() < 0.02
