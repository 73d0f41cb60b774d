"""A recording's cameras get their place; what stands in the old world is not broken silently."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack_capture.board import Board
from clothtrack_capture.camera_pose import (
    CameraPlacement,
    camera_named,
    place_by_board,
    place_by_robot,
    place_by_table,
    place_camera,
)
from clothtrack_capture.hand_eye import RobotPose

BOARD = Board(7, 5, 0.03, 0.022)


def camera_above(degrees=10.0):
    turn = Rotation.from_rotvec(np.radians([degrees, degrees / 2, 0.0])).as_matrix()
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ turn
    pose[:3, 3] = pose[:3, 2] * (0.7 / pose[2, 2])
    return Camera("top", 640, 480, 600.0, 600.0, 319.5, 239.5, pose)


def table_depth(camera):
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack(
        [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(rows.shape)], -1
    )
    return -camera.position[2] / (rays @ camera.world_from_camera[2, :3])


@pytest.fixture
def warped(board_picture):
    """Draws the board lying somewhere in the world."""
    return lambda camera, world_from_board: board_picture(
        camera, np.linalg.inv(camera.world_from_camera) @ world_from_board, BOARD
    )


@pytest.fixture
def filmed(tmp_path, warped):
    """A recording without any pose: a board on a table, turned and off the middle."""
    camera = camera_above()
    board = np.eye(4)
    board[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix()
    board[:3, 3] = [0.04, -0.02, 0.0]
    depth = table_depth(camera)
    noise = np.random.default_rng(0).normal(0, 0.001, (2, *depth.shape))
    with RecordingWriter(
        tmp_path / "film", [replace(camera, world_from_camera=np.eye(4))], {"top": 0.0005}
    ) as writer:
        for number, off in enumerate(noise):
            writer.add_frame(
                0.1 * number, color={"top": warped(camera, board)}, depth={"top": depth + off}
            )
    return read_recording(tmp_path / "film"), camera, board


def off(found, true):
    turn = Rotation.from_matrix(found[:3, :3].T @ true[:3, :3]).magnitude()
    return np.degrees(turn), 1e3 * np.linalg.norm(found[:3, 3] - true[:3, 3])


def test_by_a_board_and_by_the_table(filmed):
    recording, camera, board = filmed
    placement = place_by_board(recording, recording.cameras[0], BOARD)
    angle, distance = off(
        placement.world_from_camera, np.linalg.inv(board) @ camera.world_from_camera
    )
    assert angle < 0.2
    assert distance < 1.5
    assert abs(placement.fit["depth_beyond_board_mm"]) < 1.5
    place_camera(recording, place_by_table(recording, recording.cameras[0]))
    again = read_recording(recording.folder)
    found = again.cameras[0].world_from_camera
    np.testing.assert_allclose(again.table.normal, [0, 0, 1])
    assert np.degrees(np.arccos(found[2, :3] @ camera.world_from_camera[2, :3])) < 0.05
    assert abs(found[2, 3] - camera.position[2]) < 0.0005
    assert again.provenance["camera_placement"]["by"] == "table"


def test_keeping_the_world_changes_the_table_and_nothing_else(tmp_path, capsys):
    folder = far_table(tmp_path / "far", 0.001)
    assert cli.main(["calibrate-camera", str(folder), "--keep-world"]) == 0
    # A robot's base: turned about z, 0.3 m above the table.
    pose = np.array([[0, 1, 0, 0.4], [1, 0, 0, 0.1], [0, 0, -1, 2.2], [0, 0, 0, 1]], dtype=float)
    document = json.loads((folder / "recording.json").read_text())
    document["cameras"][0]["world_from_camera"] = pose.tolist()
    document["table"] = None
    (folder / "recording.json").write_text(json.dumps(document))
    (folder / "picker.csv").write_text("time_s,picker,x_m,y_m,z_m,closed\n0,arm,0.4,0.1,-0.2,1\n")
    assert cli.main(["calibrate-camera", str(folder)]) == 1
    assert "--keep-world" in capsys.readouterr().err
    assert cli.main(["calibrate-camera", str(folder), "--keep-world"]) == 0
    again = read_recording(folder)
    np.testing.assert_array_equal(again.cameras[0].world_from_camera, pose)
    assert abs(again.table.heights(np.array([[0.4, 0.1, -0.3]]))[0]) < 0.001
    # Without a pose the plane faces down in the world.
    document["cameras"][0]["world_from_camera"] = np.eye(4).tolist()
    (folder / "recording.json").write_text(json.dumps(document))
    assert cli.main(["calibrate-camera", str(folder), "--keep-world"]) == 1
    assert "does not face up" in capsys.readouterr().err
    board = ["--charuco", "7", "5", "0.03", "0.02"]
    assert cli.main(["calibrate-camera", str(folder), "--keep-world", *board]) == 2


def far_table(folder, noise_m):
    """A table 2.5 m under the camera, its depth off by this (standard deviation)."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 2.5
    camera = Camera("top", 160, 120, 150.0, 150.0, 79.5, 59.5, pose)
    off = np.random.default_rng(0).normal(0.0, noise_m, (120, 160))
    with RecordingWriter(folder, [camera], {"top": 0.0005}) as writer:
        writer.add_frame(0.0, depth={"top": table_depth(camera) + off})
    return folder


@pytest.mark.parametrize(("noise_mm", "warned"), [(1.0, False), (6.0, True)])
def test_a_table_that_is_hardly_a_plane_is_doubted(tmp_path, capsys, noise_mm, warned):
    folder = far_table(tmp_path / "far", 1e-3 * noise_mm)
    assert cli.main(["calibrate-camera", str(folder), "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["fit"]["residual_mm"] == pytest.approx(noise_mm, rel=0.1)
    assert ("is the plane found the table?" in said.err) == warned


def test_a_plane_that_is_no_table_is_refused_unless_told(tmp_path, capsys):
    folder = far_table(tmp_path / "far", 0.014)
    before = (folder / "recording.json").read_text()
    assert cli.main(["calibrate-camera", str(folder)]) == 1
    said = capsys.readouterr().err
    assert "(at most 10)" in said
    assert "--force" in said
    assert said.count("\n") == 1
    assert (folder / "recording.json").read_text() == before
    assert cli.main(["calibrate-camera", str(folder), "--force"]) == 0
    assert (folder / "recording.json").read_text() != before


def test_by_a_robot_that_holds_the_board(filmed, tmp_path, warped):
    recording, camera, _ = filmed
    rng = np.random.default_rng(1)
    base_from_world = np.eye(4)
    base_from_world[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 1.0]).as_matrix()
    base_from_world[:3, 3] = [0.4, 0.1, -0.1]
    gripper_from_board = np.eye(4)
    gripper_from_board[:3, 3] = [0.0, 0.02, 0.05]
    poses = []
    for number in range(9):
        board = np.eye(4)
        board[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.35, 3)).as_matrix()
        board[:3, 3] = [*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.0, 0.15)]
        path = tmp_path / f"{number}.png"
        cv2.imwrite(str(path), warped(camera, board))
        poses.append(RobotPose(path, base_from_world @ board @ np.linalg.inv(gripper_from_board)))
    placement, found = place_by_robot(recording, recording.cameras[0], BOARD, poses)
    angle, distance = off(found.pose, base_from_world @ camera.world_from_camera)
    assert angle < 0.3
    assert distance < 3.0
    assert placement.fit["pictures_used"] == 9
    assert placement.fit["residual_mm"] < 2.0
    place_camera(recording, placement)
    table = read_recording(recording.folder).table
    assert np.degrees(np.arccos(min(1.0, table.normal[2]))) < 0.3
    assert abs(table.heights(np.array([[0.4, 0.1, -0.1]]))[0]) < 0.003


def test_what_stands_in_the_world_is_not_moved_silently(write, tmp_path):
    recording = write(tmp_path / "a")
    text = (tmp_path / "a" / "recording.json").read_text()
    placement = CameraPlacement("top", camera_above().world_from_camera, None, {"by": "test"})
    with pytest.raises(InvalidRecordingError, match=r"picker.csv and the template and observed"):
        place_camera(recording, placement)
    assert (tmp_path / "a" / "recording.json").read_text() == text
    place_camera(recording, placement, force=True)
    again = read_recording(tmp_path / "a")
    np.testing.assert_allclose(
        again.cameras[0].world_from_camera, placement.world_from_camera, atol=1e-12
    )
    np.testing.assert_array_equal(
        again.picker_paths["arm"].positions, recording.picker_paths["arm"].positions
    )


def test_an_unknown_camera_is_refused(filmed):
    with pytest.raises(InvalidConfigError, match="there is no camera 'side'; cameras: top"):
        camera_named(filmed[0], "side")
