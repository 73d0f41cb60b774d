"""The verbs of setting up a recording: where its camera is, what is cloth, what moved it."""

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from clothtrack.options import AsJson
from clothtrack.terminal import complain, say

if TYPE_CHECKING:
    from clothtrack.recordings.board import Board
    from clothtrack.recordings.camera_pose import CameraPlacement

Charuco = Annotated[
    tuple[int, int, float, float] | None,
    arg(
        metavar="SQUARES_X SQUARES_Y SQUARE_M MARKER_M",
        help="the printed board: squares along both sides, side of a square and of a marker [m]",
    ),
]


def calibrate_camera(
    recording: Positional[Path],
    *,
    camera: str = "",
    charuco: Charuco = None,
    dictionary: str = "4X4_50",
    thickness: float = 0.0,
    output: Path | None = None,
    force: bool = False,
    json: AsJson = False,
) -> int:
    """Find the table and put the world on it: z up, the table at z = 0; written to the recording.

    Args:
        recording: folder with a recording.json.
        camera: by which camera, when there are several; the others keep their place beside it.
        charuco: a board on the table gives the world, instead of the table's depth.
        dictionary: of the board's markers.
        thickness: how high the print lies over the table [m].
        output: write the result to this JSON file, and leave the recording as it is.
        force: although a picker path, template or clouds stand in the present world already.
        json: machine-readable.
    """
    from clothtrack.recordings.camera_pose import camera_named, place_by_board, place_by_table
    from clothtrack.recordings.store import read_recording

    source = read_recording(recording)
    chosen = camera_named(source, camera)
    board = _board(charuco, dictionary)
    if board is None:
        placement = place_by_table(source, chosen)
    else:
        placement = place_by_board(source, chosen, board, thickness_m=thickness)
    return _placed(recording, placement, output, force=force, json=json)


def calibrate_hand_eye(
    recording: Positional[Path],
    poses: Positional[Path],
    *,
    charuco: Charuco = None,
    camera: str = "",
    dictionary: str = "4X4_50",
    camera_on_hand: bool = False,
    output: Path | None = None,
    force: bool = False,
    json: AsJson = False,
) -> int:
    """Find the camera in the robot's base, from pictures of a board that the robot holds.

    Args:
        recording: whose camera it is, for its intrinsics; gets the result.
        poses: CSV file with picture,x_m,y_m,z_m,qx,qy,qz,qw: the gripper in the robot's base.
        charuco: the board; required.
        camera: which one, when the recording has several.
        dictionary: of the board's markers.
        camera_on_hand: the camera is on the gripper and the board lies still; needs --output.
        output: write the result to this JSON file, and leave the recording as it is.
        force: although a picker path, template or clouds stand in the present world already.
        json: machine-readable.
    """
    from clothtrack.recordings.camera_pose import camera_named, place_by_robot
    from clothtrack.recordings.hand_eye import read_robot_poses
    from clothtrack.recordings.store import read_recording

    board = _board(charuco, dictionary)
    if board is None or (camera_on_hand and output is None):
        complain(
            "give --charuco, and with --camera-on-hand an --output: a recording's camera rests"
        )
        return 2
    source = read_recording(recording)
    placement, _ = place_by_robot(
        source,
        camera_named(source, camera),
        board,
        read_robot_poses(poses),
        camera_on_hand=camera_on_hand,
    )
    return _placed(recording, placement, output, force=force, json=json)


SETTING_UP_VERBS = (calibrate_camera, calibrate_hand_eye)


def _board(charuco: tuple[int, int, float, float] | None, dictionary: str) -> "Board | None":
    from clothtrack.recordings.board import Board

    return None if charuco is None else Board(*charuco, dictionary=dictionary)


def _placed(
    folder: Path, placement: "CameraPlacement", output: Path | None, *, force: bool, json: bool
) -> int:
    """Save a placement where it was wanted, and say what it is."""
    from clothtrack.recordings.camera_pose import place_camera, save_placement
    from clothtrack.recordings.store import read_recording

    if output is not None:
        save_placement(output, placement)
    else:
        place_camera(read_recording(folder), placement, force=force)
    if json:
        say(json_module.dumps(placement.as_dict(), indent=2))
        return 0
    for name, value in placement.told.items():
        if name == "per_picture":
            for one in value:
                say(f"  {one['mm']:7.2f} mm {one['deg']:7.3f} deg  {one['picture']}")
        else:
            say(f"{name:<22} {value}")
    say(f"written to             {output or folder / 'recording.json'}")
    return 0
