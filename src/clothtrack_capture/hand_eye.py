"""Hand-eye calibration: a camera's pose relative to a robot, from board pictures and robot poses.

With the camera fixed and the board in the gripper, base_from_gripper(i) gripper_from_board =
base_from_camera camera_from_board(i) in every picture i. With the camera on the hand and the board
fixed, base_from_gripper(i) gripper_from_camera camera_from_board(i) = base_from_board. Both have
the form robot(i) X board(i) = Z with two unknowns. A first guess as in Park and Martin (1994,
doi:10.1109/70.326576) is refined by least squares over X and Z together. (`cv2.calibrateHandEye` is
missing from OpenCV 5's Python module.)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from clothtrack._shown import short_repr
from clothtrack.errors import InvalidRecordingError
from clothtrack.files.csv_table import NUMBER, Column, filled, read_csv

COLUMNS = {"picture": Column(filled, "name a picture")} | dict.fromkeys(
    ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"), NUMBER
)
_LEAST_POSES = 5
_LEAST_TURN_DEG = 10.0
_METERS_PER_RADIAN = 0.3
"""Weight of rotation against translation errors: the lever arm at which both count the same [m]."""


@dataclass(frozen=True, eq=False)
class RobotPose:
    """One picture and the gripper pose reported by the robot.

    Attributes:
        picture: color picture of the board.
        base_from_gripper: rigid 4 x 4 [m].
    """

    picture: Path
    base_from_gripper: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, eq=False)
class HandEye:
    """The pose of a camera relative to a robot.

    Attributes:
        pose: base_from_camera of a fixed camera, gripper_from_camera of one on the hand.
        board: gripper_from_board, or base_from_board.
        errors_m: per picture, distance of the board from its fitted position [m].
        errors_deg: per picture, angle between the board and its fitted orientation [degrees].
    """

    pose: Float[np.ndarray, "4 4"]
    board: Float[np.ndarray, "4 4"]
    errors_m: Float[np.ndarray, " poses"]
    errors_deg: Float[np.ndarray, " poses"]

    __repr__ = short_repr


def read_robot_poses(path: Path) -> list[RobotPose]:
    """Read gripper poses in the robot's base, and the pictures taken there, from a CSV file.

    The header is `picture,x_m,y_m,z_m,qx,qy,qz,qw`. Picture paths are relative to the file.
    """
    return [_pose(path, place, row) for place, row in read_csv(path, COLUMNS)]


def calibrate_hand_eye(
    robot: Sequence[Float[np.ndarray, "4 4"]],
    camera_from_board: Sequence[Float[np.ndarray, "4 4"]],
    *,
    camera_on_hand: bool = False,
) -> HandEye:
    """Return the camera pose relative to the robot that fits all pictures best.

    Args:
        robot: base_from_gripper at each picture.
    """
    if len(robot) < _LEAST_POSES:
        raise InvalidRecordingError(
            f"{len(robot)} pictures show the board (at least {_LEAST_POSES}); take more, 10 to 20"
        )
    moves = np.stack([pose if camera_on_hand else np.linalg.inv(pose) for pose in robot])
    boards = np.stack(camera_from_board)
    pose = _first_guess(moves, boards)
    board = _mean_pose(moves @ pose @ boards)

    def off(unknowns: Float[np.ndarray, " 12"]) -> Float[np.ndarray, " residuals"]:
        shifts, turns = _disagreement(moves, boards, _rigid(unknowns[:6]), _rigid(unknowns[6:]))
        return np.concatenate([shifts.ravel(), _METERS_PER_RADIAN * turns.ravel()])

    start = np.concatenate([_unknowns(pose), _unknowns(board)])
    fit = least_squares(off, start, x_scale="jac").x
    pose, board = _rigid(fit[:6]), _rigid(fit[6:])
    shifts, turns = _disagreement(moves, boards, pose, board)
    return HandEye(
        pose,
        board,
        np.linalg.norm(shifts, axis=1),
        np.degrees(np.linalg.norm(turns, axis=1)),
    )


def _first_guess(
    moves: Float[np.ndarray, "poses 4 4"], boards: Float[np.ndarray, "poses 4 4"]
) -> Float[np.ndarray, "4 4"]:
    """Solve A X = X B for X, with the motions A, B between all pairs of pictures."""
    pairs = list(combinations(range(len(moves)), 2))
    ours = np.stack([np.linalg.inv(moves[j]) @ moves[i] for i, j in pairs])
    theirs = np.stack([boards[j] @ np.linalg.inv(boards[i]) for i, j in pairs])
    alpha = Rotation.from_matrix(ours[:, :3, :3]).as_rotvec()
    beta = Rotation.from_matrix(theirs[:, :3, :3]).as_rotvec()
    # Check the second largest spread of the rotation vectors, because rotations about one axis
    # leave one direction undetermined. Half a turn has two rotation vectors, so such pairs are left
    # out.
    sound = np.linalg.norm(alpha, axis=1) < np.radians(170.0)
    spread = np.sqrt(np.linalg.eigvalsh(alpha[sound].T @ alpha[sound] / max(sound.sum(), 1)))
    if np.degrees(spread[1]) < _LEAST_TURN_DEG:
        raise InvalidRecordingError(
            f"the poses turn by {np.degrees(spread[2]):.0f} degrees about one axis and by "
            f"{np.degrees(spread[1]):.0f} about others (at least {_LEAST_TURN_DEG:.0f}); turn the "
            "hand about two axes, by 20 to 40 degrees"
        )
    turn = Rotation.align_vectors(alpha[sound], beta[sound])[0]
    rows = ours[:, :3, :3] - np.eye(3)
    sides = theirs[:, :3, 3] @ turn.as_matrix().T - ours[:, :3, 3]
    shift, *_ = np.linalg.lstsq(rows.reshape(-1, 3), sides.ravel(), rcond=None)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.as_matrix(), shift
    return pose


def _disagreement(
    moves: Float[np.ndarray, "poses 4 4"],
    boards: Float[np.ndarray, "poses 4 4"],
    pose: Float[np.ndarray, "4 4"],
    board: Float[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "poses 3"], Float[np.ndarray, "poses 3"]]:
    """Return the deviation of the board from its fitted pose per picture, in [m] and [rad]."""
    text = moves @ pose @ boards
    turns = Rotation.from_matrix(board[:3, :3].T @ text[:, :3, :3]).as_rotvec()
    return text[:, :3, 3] - board[:3, 3], turns


def _mean_pose(poses: Float[np.ndarray, "poses 4 4"]) -> Float[np.ndarray, "4 4"]:
    mean = np.eye(4)
    mean[:3, :3] = Rotation.from_matrix(poses[:, :3, :3]).mean().as_matrix()
    mean[:3, 3] = np.median(poses[:, :3, 3], axis=0)
    return mean


def _rigid(unknowns: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "4 4"]:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(unknowns[:3]).as_matrix()
    pose[:3, 3] = unknowns[3:]
    return pose


def _unknowns(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, " 6"]:
    return np.concatenate([Rotation.from_matrix(pose[:3, :3]).as_rotvec(), pose[:3, 3]])


def _pose(path: Path, place: str, row: list[Any]) -> RobotPose:
    picture, *values = row
    length = math.sqrt(sum(value * value for value in values[3:]))
    if not abs(length - 1.0) < 1e-2:
        raise InvalidRecordingError(
            f"{place}: the quaternion has length {length:.3g}, not 1; write qx, qy, qz, qw in this "
            "order"
        )
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(values[3:]).as_matrix()
    pose[:3, 3] = values[:3]
    return RobotPose(path.parent / picture, pose)
