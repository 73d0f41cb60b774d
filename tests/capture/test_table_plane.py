"""The table's plane: exact on exact depth, known error on noisy depth, refused where it is none."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.table_plane import fit_plane, sight_lines, world_from_table
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.recordings.recorded_table import fit_recorded_table, moved_along
from clothtrack.recordings.recording import ClothDescription, PickerPath
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack_lab.world.appearance import Appearance
from clothtrack_lab.world.scene import Scene
from clothtrack_lab.world.sensor import Sensor
from clothtrack_lab.world.tool import Tool


def tilted(degrees, azimuth=0.4, height=0.75, width=320):
    """A camera that looks at the table's origin from straight above or from the side."""
    turn, _ = cv2.Rodrigues(np.radians(degrees) * np.array([np.cos(azimuth), np.sin(azimuth), 0]))
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ turn
    pose[:3, 3] = pose[:3, 2] * (height / pose[2, 2])
    focal, rows = 0.94 * width, width * 3 // 4
    return Camera("top", width, rows, focal, focal, (width - 1) / 2, (rows - 1) / 2, pose)


def plane_depth(camera, height=0.0):
    """Depth of the plane z = height in the world [m], 0 where it is not seen."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack(
        [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(rows.shape)], -1
    )
    down = rays @ camera.world_from_camera[2, :3]
    with np.errstate(divide="ignore"):
        depth = (height - camera.position[2]) / down
    return np.where((depth > 0) & (depth < 3.0), depth, 0.0)


def error(camera, fit):
    """Angle [degrees] and distance [mm] between a plane and the true table."""
    up = camera.world_from_camera[2, :3]
    angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(up, fit.normal)), up @ fit.normal))
    return angle, 1e3 * abs(fit.distance_m - camera.position[2])


@pytest.mark.parametrize("degrees", [0.0, 10.0, 35.0, 55.0])
def test_exact_depth_gives_the_exact_plane(degrees):
    camera = tilted(degrees)
    fit = fit_plane(*sight_lines(plane_depth(camera), camera, stride=3))
    angle, distance = error(camera, fit)
    assert angle < 1e-4
    assert distance < 1e-3
    assert fit.tilt_deg == pytest.approx(degrees, abs=1e-3)
    assert fit.inlier_share == 1.0


@pytest.mark.parametrize("degrees", [0.0, 20.0, 40.0])
def test_the_world_stands_on_the_table_under_the_middle_of_the_picture(degrees):
    camera = tilted(degrees)
    fit = fit_plane(*sight_lines(plane_depth(camera), camera, stride=3))
    found = replace(camera, world_from_camera=world_from_table(camera, fit))
    middle = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]])
    pixels, _ = found.project(middle)
    np.testing.assert_allclose(pixels[0], [camera.cx, camera.cy], atol=1e-4)
    np.testing.assert_allclose(found.back_project(plane_depth(camera))[:, 2], 0.0, atol=1e-6)
    assert found.position[2] == pytest.approx(camera.position[2], abs=1e-6)
    x_of_camera = found.world_from_camera[:3, 0]
    assert x_of_camera[0] > 0
    assert abs(x_of_camera[1]) < 1e-9


@pytest.mark.parametrize(("kind", "degrees"), [("towel", 0.0), ("tshirt", 15.0), ("towel", 35.0)])
def test_the_simulated_camera_places_the_table_to_a_tenth_of_a_degree_and_a_millimeter(
    kind, degrees
):
    camera = tilted(degrees, width=640)
    cloth = garment(kind, vertex_count=300)
    vertices = cloth.vertices - [0, 0, cloth.vertices[:, 2].min() - 0.002]
    config = SensorConfig()
    for seed in range(2):
        sensor = Sensor(Scene(cloth, Tool(), camera), config, Appearance(), seed=seed)
        depth = sensor.capture(vertices, np.array([0.05, 0.05, 0.03])).depth
        angle, distance = error(camera, fit_plane(*sight_lines(depth, camera, stride=6)))
        assert angle < 0.15
        assert distance < 1.5


def test_cloth_that_fills_the_picture_is_not_the_table_when_it_lies_clearly_on_it():
    camera = tilted(5.0)
    depth, raised = plane_depth(camera), plane_depth(camera, 0.02)
    depth[20:-20, 30:-30] = raised[20:-20, 30:-30]
    assert (depth != plane_depth(camera)).mean() > 0.6
    angle, distance = error(camera, fit_plane(*sight_lines(depth, camera, stride=2)))
    assert angle < 0.01
    assert distance < 0.1


def ball(camera):
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return 1.0 + 0.8 * (np.hypot(columns - camera.cx, rows - camera.cy) / camera.width) ** 2


def corner_of_a_room(camera):
    depth = plane_depth(camera)
    columns = np.arange(camera.width)
    wall = 1.0 / (1.3 - np.abs(columns - camera.cx) / camera.width)
    depth[:, : camera.width // 2] = wall[: camera.width // 2]
    return depth


def nothing(camera):
    return np.zeros((camera.height, camera.width))


def noise(camera):
    return np.random.default_rng(0).uniform(0.3, 3.0, (camera.height, camera.width))


@pytest.mark.parametrize(
    ("scene", "told"),
    [
        (ball, "no plane dominates"),
        (noise, "no plane dominates"),
        (corner_of_a_room, "two planes"),
        (nothing, "only 0 measurements"),
    ],
)
def test_what_has_no_dominant_plane_is_refused(scene, told):
    camera = tilted(3.0)
    with pytest.raises(InvalidRecordingError, match=told):
        fit_plane(*sight_lines(scene(camera), camera, stride=3))


def filmed(folder, camera, *, masked, height=0.003, share=0.9):
    """Frames of a cloth of this height over most of the picture, with masks or without."""
    depth, mask = plane_depth(camera), np.zeros((camera.height, camera.width), dtype=bool)
    rows, columns = int(share * camera.height), int(share * camera.width)
    mask[:rows, :columns] = True
    depth[mask] = plane_depth(camera, height)[mask]
    rng = np.random.default_rng(1)
    blind = replace(camera, world_from_camera=np.eye(4))
    with RecordingWriter(folder, [blind], {"top": 0.0001}, cloth=ClothDescription()) as writer:
        for frame in range(3):
            noisy = depth + 0.001 * rng.standard_normal(depth.shape)
            writer.add_frame(
                0.1 * frame, depth={"top": noisy}, mask={"top": mask} if masked else None
            )
    return read_recording(folder)


def test_cloth_that_masks_show_is_left_out(tmp_path):
    camera = tilted(8.0)
    with_masks = filmed(tmp_path / "with", camera, masked=True)
    without = filmed(tmp_path / "without", camera, masked=False)
    known = fit_recorded_table(with_masks, with_masks.cameras[0])
    unknown = fit_recorded_table(without, without.cameras[0])
    assert known.cloth_excluded
    assert not unknown.cloth_excluded
    assert error(camera, known)[1] < 0.3
    full = filmed(tmp_path / "full", camera, masked=True, share=1.0)
    with pytest.raises(InvalidRecordingError, match="hardly anything but the cloth"):
        fit_recorded_table(full, full.cameras[0])
    # Without them the plane is that of the cloth, higher by its thickness at most.
    assert 1.0 < error(camera, unknown)[1] < 3.5


def test_other_cameras_keep_their_place_beside_the_one_that_is_calibrated(tmp_path):
    left, right = tilted(20.0), replace(tilted(-20.0, azimuth=1.0), name="right")
    with RecordingWriter(tmp_path / "two", [left, right], {"top": 0.001, "right": 0.001}) as writer:
        writer.add_frame(0.0, depth={"top": plane_depth(left), "right": plane_depth(right)})
        writer.set_picker_path("arm", PickerPath(np.zeros(1), np.zeros((1, 3)), np.array([False])))
    recording = read_recording(tmp_path / "two")
    pose = tilted(5.0, height=0.9).world_from_camera
    poses = moved_along(recording, recording.cameras[0], pose)
    between = np.linalg.inv(poses["top"]) @ poses["right"]
    expected = np.linalg.inv(left.world_from_camera) @ right.world_from_camera
    np.testing.assert_allclose(between, expected, atol=1e-9)
    np.testing.assert_array_equal(poses["top"], pose)
