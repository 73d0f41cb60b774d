"""A cloud becomes the depth picture that a camera straight above would have taken."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.reconstruction.data.cloud_picture import (
    LEAST_POINTS,
    cloud_picture,
)
from clothtrack.reconstruction.data.pseudo_labels import cloth_picture
from clothtrack.reconstruction.depth_input import from_recording
from clothtrack.recordings.recording import ClothDescription, Table
from clothtrack.recordings.store import RecordingWriter, read_recording

SIDE_M = 0.2
STEP_M = 0.003


def plane(height_m, *, corner=(1.0, -2.0), side_m=SIDE_M, step_m=STEP_M):
    """A level square of points, somewhere in the world."""
    steps = np.arange(0.0, side_m + 1e-9, step_m)
    x, y = np.meshgrid(corner[0] + steps, corner[1] + steps)
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, height_m)], axis=1)


@pytest.fixture
def held_corner():
    """A square on the table, one half of it folded over at 30 mm above."""
    return np.concatenate([plane(0.0), plane(0.03, side_m=0.1)])


def test_a_hole_of_one_pixel_is_closed_and_a_large_one_stays():
    sheet = plane(0.0, step_m=0.002)
    middle = np.array([1.1, -1.9, 0.0])
    apart = np.linalg.norm(sheet - middle, axis=1)
    _, whole, _ = cloud_picture(sheet)
    _, pierced, _ = cloud_picture(sheet[apart > 0.003])
    _, torn, camera = cloud_picture(sheet[apart > 0.03])
    assert pierced.sum() >= whole.sum() - 1
    ((column, row),), _ = camera.project(middle[None])
    gap = torn[int(row) - 3 : int(row) + 4, int(column) - 3 : int(column) + 4]
    assert not gap.any()


def test_too_few_points_are_no_cloth():
    with pytest.raises(InvalidRecordingError, match="a cloud of 15 points shows no cloth"):
        cloud_picture(plane(0.0)[: LEAST_POINTS - 1])


@pytest.fixture
def only_clouds(tmp_path, held_corner):
    """A recording that has clouds and no pictures, and its folder."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = 1.1, -1.9, 1.0
    folder = tmp_path / "clouds"
    with RecordingWriter(
        folder,
        cameras=(Camera("side", 640, 480, 600.0, 600.0, 320.0, 240.0, pose),),
        depth_units_m={"side": 0.001},
        table=Table(np.zeros(3), np.array([0.0, 0.0, 1.0])),
        cloth=ClothDescription(kind="towel", size_m=(0.25, 0.2)),
        provenance={},
    ) as writer:
        for time_s in (0.0, 0.1):
            writer.add_frame(time_s, color=None, depth=None, mask=None, cloud=held_corner)
    return folder


def test_a_recording_of_clouds_is_a_picture_for_the_network(only_clouds, held_corner):
    given = from_recording(only_clouds, 1)
    recording = read_recording(only_clouds)
    depth, mask, camera = cloth_picture(recording, recording.frames[1])
    np.testing.assert_array_equal(given.depth_m, depth)
    assert (given.kind, given.size_m) == ("towel", (0.25, 0.2))
    top = camera.back_project(depth, mask)[:, 2].max()
    assert top == pytest.approx(held_corner[:, 2].max(), abs=1e-3)


def test_a_frame_with_neither_is_refused(only_clouds):
    recording = read_recording(only_clouds)
    with pytest.raises(InvalidRecordingError, match="neither a depth picture nor a cloud"):
        cloth_picture(recording, replace(recording.frames[0], cloud=None))


def test_points_come_back_where_they_were_and_the_upper_layer_is_seen(held_corner):
    depth, mask, camera = cloud_picture(held_corner)
    np.testing.assert_array_equal(camera.world_from_camera[:3, 2], [0, 0, -1])
    seen = camera.back_project(depth, mask)
    over = (held_corner[:, 0] <= 1.1) & (held_corner[:, 1] <= -1.9)
    top = held_corner[~over | (held_corner[:, 2] > 0)]
    pixel_m = camera.position[2] / camera.fx
    assert max(np.linalg.norm(seen - one, axis=1).min() for one in top) < 1.5 * pixel_m
    inside = (np.abs(seen[:, 0] - 1.05) < 0.04) & (np.abs(seen[:, 1] + 1.95) < 0.04)
    np.testing.assert_allclose(seen[inside, 2], 0.03, atol=1e-9)
