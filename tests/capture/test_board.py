"""ChArUco boards, rendered at known poses."""

import cv2
import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack_capture.board import Board, locate_board, locate_boards

BOARD = Board(7, 5, 0.03, 0.022)
CAMERA = Camera("top", 640, 480, 600.0, 602.0, 321.0, 238.0)


def pose_of(turn, shift):
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.asarray(turn, dtype=float))[0] @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = shift
    return pose


@pytest.fixture
def rendered(board_picture):
    """A gray table with the board on it, blurred and noisy with a seed."""

    def picture(pose, board=BOARD, seed=None):
        shown = board_picture(CAMERA, pose, board)
        if seed is None:
            return shown
        noise = np.random.default_rng(seed).normal(0, 5, (*shown.shape[:2], 1))
        shown = cv2.GaussianBlur(shown, (0, 0), 0.8) * 0.8 + 15 + noise
        return np.clip(shown, 0, 255).astype(np.uint8)

    return picture


def off(found, true):
    """Angle [degrees] and distance [mm] between two poses."""
    turn, _ = cv2.Rodrigues(found[:3, :3].T @ true[:3, :3])
    return np.degrees(np.linalg.norm(turn)), 1e3 * np.linalg.norm(found[:3, 3] - true[:3, 3])


@pytest.mark.parametrize(
    ("turn", "shift"),
    [
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.6]),
        ([0.3, 0.1, 0.4], [0.03, -0.02, 0.6]),
        ([-0.5, 0.3, -2.0], [-0.05, 0.03, 0.7]),
    ],
)
def test_a_rendered_board_is_where_it_was_put(turn, shift, rendered):
    true = pose_of(turn, shift)
    found = locate_board([rendered(true)], BOARD, CAMERA)
    angle, distance = off(found.camera_from_board, true)
    assert found.corners == 24
    assert found.residual_px < 0.1
    assert angle < 0.1
    assert distance < 0.5


def test_noise_averages_out_over_pictures_of_a_still_board(rendered):
    true = pose_of([0.35, -0.1, 0.2], [0.02, 0.0, 0.65])
    pictures = [rendered(true, seed=seed) for seed in range(6)]
    angle, distance = off(locate_board(pictures, BOARD, CAMERA).camera_from_board, true)
    assert angle < 0.15
    assert distance < 1.0


def test_a_board_printed_the_old_way_is_known_too(rendered):
    old = Board(6, 4, 0.03, 0.022)
    old._boards[0].setLegacyPattern(True)
    true = pose_of([0.2, 0.1, 0.0], [0.0, 0.0, 0.5])
    angle, distance = off(
        locate_board([rendered(true, old)], Board(6, 4, 0.03, 0.022), CAMERA).camera_from_board,
        true,
    )
    assert angle < 0.2
    assert distance < 0.5


def test_pictures_without_the_board_give_none(rendered):
    empty = np.full((480, 640, 3), 200, np.uint8)
    true = pose_of([0.2, 0.1, 0.0], [0.0, 0.0, 0.6])
    found = locate_boards([empty, rendered(true)], BOARD, CAMERA)
    assert found[0] is None
    assert off(found[1].camera_from_board, true)[1] < 0.5
    with pytest.raises(InvalidRecordingError, match="0 corners of the board are seen"):
        locate_board([empty], BOARD, CAMERA)


def test_a_board_that_moved_between_the_pictures_is_refused(rendered):
    one = rendered(pose_of([0.2, 0.1, 0.0], [0.0, 0.0, 0.6]))
    two = rendered(pose_of([0.2, 0.1, 0.3], [0.04, 0.0, 0.6]))
    with pytest.raises(InvalidRecordingError, match="it moved between the pictures"):
        locate_board([one, two], BOARD, CAMERA)


@pytest.mark.parametrize(
    ("board", "told"),
    [
        ((2, 5, 0.03, 0.02), "at least 3 x 3"),
        ((7, 5, 0.02, 0.03), "smaller than its square"),
        ((7, 5, 0.03, 0.02, "9X9"), "choose from"),
    ],
)
def test_what_cannot_be_printed_is_refused(board, told):
    with pytest.raises(InvalidConfigError, match=told):
        Board(*board)
