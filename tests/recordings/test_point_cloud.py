"""The observed points lie on the surface that made them; silence is only where nothing was seen."""

import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.camera_view import flying_pixels
from clothtrack.recordings.point_cloud import (
    Observation,
    cloth_measured,
    hidden_pixels,
    observe,
    strays,
    thin,
)
from clothtrack.recordings.recording import ObservedRegion, PickerPath, Table
from clothtrack.recordings.store import RecordingWriter, read_recording

WIDTH, HEIGHT = 160, 120
TABLE = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
EVERYTHING = np.ones((HEIGHT, WIDTH), dtype=bool)


def looking_at_origin(name, position):
    forward = -np.asarray(position) / np.linalg.norm(position)
    right = np.cross(forward, [0.0, 0.2, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = position
    return Camera(name, WIDTH, HEIGHT, 150.0, 148.0, 78.0, 61.0, pose)


def plane_depth(camera, height_m):
    """Depth of the plane z = height_m in every pixel."""
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack(
        [
            (columns - camera.cx) / camera.fx,
            (rows - camera.cy) / camera.fy,
            np.ones((HEIGHT, WIDTH)),
        ],
        axis=-1,
    )
    climb = rays @ camera.world_from_camera[2, :3]
    return (height_m - camera.position[2]) / climb


def record(folder, cameras, frame, **more):
    units = {camera.name: 0.0001 for camera in cameras}
    with RecordingWriter(folder, cameras, units, **more) as writer:
        writer.add_frame(0.0, **frame)
    return read_recording(folder)


def test_back_projection_inverts_projection():
    camera = looking_at_origin("a", [0.3, -0.2, 0.7])
    depth = np.random.default_rng(0).uniform(0.2, 2.0, (HEIGHT, WIDTH))
    pixels, back = camera.project(camera.back_project(depth))
    rows, columns = np.nonzero(depth)
    np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=1), atol=1e-9)
    np.testing.assert_allclose(back, depth.ravel(), atol=1e-12)


@pytest.mark.parametrize("spacing_m", [None, 0.004, 0.02])
def test_a_plane_is_observed_where_it_is_by_two_cameras(tmp_path, spacing_m):
    cameras = [looking_at_origin("a", [0.3, -0.2, 0.7]), looking_at_origin("b", [-0.4, 0.1, 0.5])]
    frame = {
        "depth": {camera.name: plane_depth(camera, 0.05) for camera in cameras},
        "mask": {camera.name: EVERYTHING for camera in cameras},
    }
    recording = record(tmp_path / "r", cameras, frame, table=TABLE)
    seen = observe(recording, recording.frames[0], spacing_m=spacing_m)
    assert np.abs(seen.points[:, 2] - 0.05).max() < 1e-4  # the depth unit
    assert np.linalg.norm(seen.points[:, :2], axis=1).min() < 0.02
    assert {camera.name for camera in seen.cameras} == set(seen.hidden)
    if spacing_m is None:
        # A few pixels of the far corners stand alone.
        assert 0.999 * 2 * WIDTH * HEIGHT < len(seen.points) <= 2 * WIDTH * HEIGHT
    else:
        assert len(seen.points) < 2 * WIDTH * HEIGHT


def test_a_cloud_stands_for_the_whole_frame(tmp_path):
    camera = looking_at_origin("a", [0.3, -0.2, 0.7])
    cloud = np.random.default_rng(0).uniform(-0.03, 0.03, (500, 3))
    recording = record(tmp_path / "r", [camera], {"cloud": cloud})
    seen = observe(recording, recording.frames[0], spacing_m=None)
    np.testing.assert_array_equal(seen.points, cloud)
    assert seen.hidden == {}
    assert not seen.unobservable(cloud).any()


def test_thinning_leaves_one_mean_point_per_cube():
    points = np.random.default_rng(0).uniform(0, 0.1, (5000, 3))
    thinned = thin(points, 0.02)
    counts = (np.floor((points - points.mean(axis=0)) / 0.02)).astype(int)
    cubes, members = np.unique(counts, axis=0, return_inverse=True)
    means = np.array([points[members == cube].mean(axis=0) for cube in range(len(cubes))])
    assert len(thinned) == len(means)
    order, expected = np.lexsort(thinned.T), np.lexsort(means.T)
    np.testing.assert_allclose(thinned[order], means[expected], atol=1e-12)
    assert len(thin(np.zeros((0, 3)), 0.02)) == 0


def test_a_far_outlier_changes_no_other_cube():
    # With it there are too many cubes to count one by one.
    cloud = np.random.default_rng(3).uniform(0.0, 0.3, (2000, 3))
    both = np.concatenate(
        [cloud, cloud.mean(0) + [[500.0, 500.0, 500.0], [-500.0, -500.0, -500.0]]]
    )
    few = thin(both, 0.01)
    np.testing.assert_allclose(few[1:-1], thin(cloud, 0.01), atol=1e-12)


def test_a_rim_of_background_is_not_cloth():
    camera = Camera("top", 64, 48, 60.0, 60.0, 31.5, 23.5, np.diag([1.0, -1.0, -1.0, 1.0]))
    depth = np.full((48, 64), 0.8)
    depth[10:40, 10:50] = 0.5
    cloth = depth == 0.5
    # A mask one pixel too wide on one side shows the wall behind.
    mask = cloth.copy()
    mask[10:40, 50] = True
    np.testing.assert_array_equal(cloth_measured(depth, mask, camera), cloth)
    depth[12:14, 12:14] = 0.0
    assert not cloth_measured(depth, mask, camera)[12:14, 12:14].any()
    assert not cloth_measured(depth, np.zeros_like(mask), camera).any()


def kept(points, share):
    return points[~strays(points, share)]


def test_stray_clusters_go_and_the_cloth_stays_in_order():
    rng = np.random.default_rng(0)
    cloth = rng.uniform(0, 0.2, (6000, 3)) * [1, 1, 0]
    stray = rng.normal(loc=(0.1, 0.1, 0.05), scale=0.002, size=(100, 3))
    both = np.vstack([stray, cloth])
    np.testing.assert_array_equal(kept(both, 0.04), cloth)
    # A cluster of more than the share is no stray, and a share of 0 keeps everything.
    large = np.vstack([cloth, np.repeat(stray, 3, axis=0)])
    assert len(kept(large, 0.04)) == len(large)
    assert len(kept(both, 0.0)) == len(both)
    # A scattered cloud is not thrown away whole.
    assert len(kept(rng.uniform(0, 9, (50, 3)), 0.04)) == 50


@pytest.mark.parametrize(("gap_m", "clusters"), [(0.0065, 1), (0.0245, 2)])
def test_points_are_linked_by_their_distance(gap_m, clusters):
    rng = np.random.default_rng(0)
    for _ in range(20):
        direction = rng.normal(size=3)
        step = gap_m * direction / np.linalg.norm(direction)
        points = np.array([np.zeros(3), np.zeros(3), step]) + rng.uniform(0, 1, 3)
        assert len(kept(points, 0.5)) == (3 if clusters == 1 else 2)


def test_flying_pixels_between_two_surfaces_go_and_rims_stay():
    depth = np.full((20, 30), 0.6)
    depth[:, :10] = 0.5
    depth[:, 10] = 0.55
    flying = flying_pixels(depth, 150.0)
    assert flying[:, 10].all()
    assert flying.sum() == 20
    np.testing.assert_array_equal(flying_pixels(depth.T, 150.0), flying.T)


@pytest.mark.parametrize("shape", [(150, 70), (61, 3), (2, 5), (60, 2)])
def test_flying_pixels_are_those_of_the_definition(shape):
    rng = np.random.default_rng(2)
    depth = rng.uniform(0.4, 0.6, shape).astype(np.float32)
    depth[rng.random(shape) < 0.2] = 0.0
    expected = np.zeros(shape, dtype=bool)
    for row in range(shape[0]):
        for column in range(shape[1]):
            for line, place in ((depth[:, column], row), (depth[row], column)):
                if 0 < place < len(line) - 1:
                    back, here, front = line[place - 1 : place + 2]
                    limit = 6.0 / 150.0 * here + 0.004
                    climbs = here - back > limit and front - here > limit and back > 0
                    falls = back - here > limit and here - front > limit and front > 0
                    expected[row, column] |= climbs or falls
    np.testing.assert_array_equal(flying_pixels(depth, 150.0), expected)


def test_a_steep_surface_does_not_fly():
    # 75 degrees against the view: tan(75) * z / f per pixel.
    column = np.arange(40)
    depth = np.tile(0.4 + column * np.tan(np.radians(75)) * 0.4 / 600.0, (10, 1))
    assert not flying_pixels(depth, 600.0).any()


def test_hidden_is_what_was_not_measured_and_the_tool_with_two_pixels_around():
    camera = looking_at_origin("a", [0.0, 0.001, 0.6])
    depth = plane_depth(camera, 0.0)
    depth[50:53, 60:63] = 0.0
    depth[80:84, 100:103] = 0.5
    depth[20:22, ::3] = 0.0  # specks
    hidden = hidden_pixels(depth, ~EVERYTHING, depth == 0, camera, TABLE)
    expected = np.zeros_like(hidden)
    expected[48:55, 58:65] = True
    expected[78:86, 98:105] = True
    np.testing.assert_array_equal(hidden, expected)
    # What the mask calls cloth is no tool, however high.
    assert hidden_pixels(depth, EVERYTHING, depth == 0, camera, TABLE).sum() == 49


def test_without_a_table_an_unmeasured_background_hides_nothing():
    camera = looking_at_origin("a", [0.0, 0.001, 0.6])
    depth = plane_depth(camera, 0.0)
    mask = EVERYTHING.copy()
    mask[:, 80:] = False
    depth[~mask] = 0.0
    assert not hidden_pixels(depth, mask, depth == 0, camera, None).any()


def test_silence_means_nothing_only_where_nothing_could_be_seen():
    camera = looking_at_origin("a", [0.0, 0.001, 0.6])
    hidden = ~EVERYTHING
    hidden[:, : WIDTH // 2] = True
    seen = Observation(
        np.zeros((1, 3)), (camera,), {"a": hidden}, -0.1, np.array([[0.02, 0.0, 0.02]]), 0.01
    )
    depth = np.zeros((HEIGHT, WIDTH))
    depth[60, 20] = depth[60, 140] = 0.6
    on_hidden, in_view = camera.back_project(depth)
    vertices = np.stack(
        [on_hidden, in_view, [5.0, 0, 0], [0, 0, 0.9], [0.02, 0, 0.025], in_view - [0, 0, 0.09]]
    )
    expected = [True, False, True, True, True, True]
    np.testing.assert_array_equal(seen.unobservable(vertices), expected)
    other = looking_at_origin("b", [0.1, 0.1, 0.6])
    both = Observation(seen.points, (camera, other), {"a": hidden}, None, np.zeros((0, 3)), 0.0)
    np.testing.assert_array_equal(both.unobservable(np.stack([on_hidden, in_view])), [False, False])


def test_tool_positions_are_those_of_the_frame(tmp_path):
    camera = looking_at_origin("a", [0.0, 0.001, 0.6])
    path = PickerPath(np.array([0.0, 2.0]), np.array([[0.0, 0, 0], [0, 0, 1]]), np.ones(2, bool))
    with RecordingWriter(
        tmp_path / "r", [camera], {"a": 0.001}, observed=ObservedRegion(None, 0.03), table=TABLE
    ) as writer:
        for time in (0.0, 1.0):
            writer.add_frame(time, depth={"a": plane_depth(camera, 0.0)}, mask={"a": EVERYTHING})
        writer.set_picker_path("arm", path)
    recording = read_recording(tmp_path / "r")
    seen = observe(recording, recording.frames[1])
    np.testing.assert_allclose(seen.tool_positions, [[0, 0, 0.5]])
    assert seen.tool_clearance_m == 0.03


def test_no_cloth_is_an_error_that_says_where_to_look(tmp_path):
    camera = looking_at_origin("a", [0.0, 0.001, 0.6])
    depth = plane_depth(camera, 0.0)
    depth[:, :80] = 0
    mask = EVERYTHING.copy()
    mask[:, 80:] = False
    recording = record(tmp_path / "r", [camera], {"depth": {"a": depth}, "mask": {"a": mask}})
    with pytest.raises(InvalidRecordingError, match="no cloth is found in frame 0; look at its"):
        observe(recording, recording.frames[0])


def test_a_segmenter_of_ones_own_is_asked(tmp_path):
    camera = looking_at_origin("a", [0.0, 0.001, 0.6])
    recording = record(tmp_path / "r", [camera], {"depth": {"a": plane_depth(camera, 0.0)}})

    def left_half(color, depth_m, camera, table):
        assert color is None
        return np.arange(WIDTH)[None, :] < np.full((HEIGHT, 1), WIDTH // 2)

    seen = observe(recording, recording.frames[0], left_half, spacing_m=None)
    assert len(seen.points) == WIDTH * HEIGHT // 2
