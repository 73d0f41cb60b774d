"""Hand-eye calibration: exact on exact poses, as good as the board on noisy ones."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clothtrack.errors import InvalidRecordingError
from clothtrack_capture.hand_eye import calibrate_hand_eye, read_robot_poses


def pose_of(turn, shift):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    pose[:3, 3] = shift
    return pose


def pictures(rng, count, *, on_hand, turn=0.5, noise_m=0.0, noise_deg=0.0):
    """The true camera, and what robot and camera say in some pictures."""
    camera = pose_of(rng.normal(0, 1, 3), rng.normal(0, 0.5, 3))
    board = pose_of(rng.normal(0, 1, 3), rng.normal(0, 0.1, 3))
    robot, seen = [], []
    for _ in range(count):
        hand = pose_of(rng.normal(0, turn, 3), rng.normal(0, 0.2, 3))
        if on_hand:
            true = np.linalg.inv(hand @ camera) @ board
        else:
            true = np.linalg.inv(camera) @ hand @ board
        wrong = pose_of(np.radians(noise_deg) * rng.normal(0, 1, 3), noise_m * rng.normal(0, 1, 3))
        robot.append(hand)
        seen.append(true @ wrong)
    return camera, robot, seen


def off(found, true):
    turn = Rotation.from_matrix(found[:3, :3].T @ true[:3, :3]).magnitude()
    return np.degrees(turn), 1e3 * np.linalg.norm(found[:3, 3] - true[:3, 3])


@pytest.mark.parametrize("on_hand", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_exact_poses_give_the_exact_camera(on_hand, seed):
    rng = np.random.default_rng(seed)
    camera, robot, seen = pictures(rng, 6, on_hand=on_hand)
    found = calibrate_hand_eye(robot, seen, camera_on_hand=on_hand)
    angle, distance = off(found.pose, camera)
    assert angle < 1e-4
    assert distance < 1e-3
    assert found.errors_m.max() < 1e-6
    assert found.errors_deg.max() < 1e-4


@pytest.mark.parametrize("on_hand", [False, True])
def test_noise_of_the_board_averages_out_and_shows_in_the_residuals(on_hand):
    rng = np.random.default_rng(1)
    angles, distances = [], []
    for _ in range(5):
        camera, robot, seen = pictures(rng, 15, on_hand=on_hand, noise_m=0.001, noise_deg=0.2)
        found = calibrate_hand_eye(robot, seen, camera_on_hand=on_hand)
        angle, distance = off(found.pose, camera)
        angles.append(angle)
        distances.append(distance)
        assert 0.0003 < np.sqrt(np.mean(found.errors_m**2)) < 0.005
        assert 0.1 < np.sqrt(np.mean(found.errors_deg**2)) < 0.8
    assert np.median(angles) < 0.2
    assert np.median(distances) < 2.5


def test_poses_that_say_too_little_are_refused():
    rng = np.random.default_rng(3)
    _, robot, seen = pictures(rng, 4, on_hand=False)
    with pytest.raises(InvalidRecordingError, match="4 pictures show the board"):
        calibrate_hand_eye(robot, seen)
    turns = [pose_of([0.0, 0.0, angle], [0.1 * angle, 0.0, 0.3]) for angle in range(6)]
    with pytest.raises(InvalidRecordingError, match="about two axes"):
        calibrate_hand_eye([pose_of([0, 0, 0.2 * k], [0.0, 0.1 * k, 0]) for k in range(6)], turns)


HEAD = "picture,x_m,y_m,z_m,qx,qy,qz,qw\n"


def test_robot_poses_are_read(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(HEAD + "shots/0.png,0.1,0.2,0.3,0,0,0.70710678,0.70710678\n\n")
    (pose,) = read_robot_poses(path)
    assert pose.picture == tmp_path / "shots" / "0.png"
    np.testing.assert_allclose(pose.base_from_gripper[:3, 0], [0, 1, 0], atol=1e-7)
    np.testing.assert_allclose(pose.base_from_gripper[:3, 3], [0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "the first line is ''"),
        (HEAD + "0.png,1,2,3\n", "line 2 has 4 fields"),
        (HEAD + "0.png,0,0,zero,0,0,0,1\n", "z_m is 'zero'; write a number"),
        (HEAD + "0.png,0,0,0,1,1,0,1\n", "the quaternion has length"),
        (HEAD + "0.png,inf,0,0,0,0,0,1\n", "x_m is 'inf'; write a number"),
    ],
)
def test_what_is_no_pose_is_refused(tmp_path, text, told):
    path = tmp_path / "poses.csv"
    path.write_text(text)
    with pytest.raises(InvalidRecordingError, match=told):
        read_robot_poses(path)
