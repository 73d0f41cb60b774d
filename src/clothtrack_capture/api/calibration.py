"""Calibrate a recording's camera pose from the table, a board or a robot."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from clothtrack.api.results import Result
from clothtrack.errors import WrongUsageError

if TYPE_CHECKING:
    from clothtrack.geometry.camera import Camera
    from clothtrack.recordings.recording import Recording
    from clothtrack_capture.board import Board
    from clothtrack_capture.camera_pose import CameraPlacement

Charuco = Annotated[
    tuple[int, int, float, float] | None, arg(metavar="SQUARES_X SQUARES_Y SQUARE_M MARKER_M")
]


def calibrate_camera(
    recording: "Recording | Path | str",
    *,
    charuco: Charuco = None,
    robot_poses: Path | str | None = None,
    camera_on_hand: bool = False,
    keep_world: bool = False,
    camera: str = "",
    dictionary: str = "4X4_50",
    output: Path | str | None = None,
    force: bool = False,
) -> "Recording | Result":
    """Find the table and set the world on it, with z up and the table at z = 0.

    The result is written to the recording; of a `Recording`, a new one is returned instead. With
    --robot-poses the world is the robot's base, and its gripper holds the board.

    Args:
        recording: folder with a recording.json.
        charuco: define the world by a printed board instead of the table's depth; give the number
            of squares along both sides, the side of a square and the side of a marker [m].
        robot_poses: CSV file with picture,x_m,y_m,z_m,qx,qy,qz,qw: pictures of the board that a
            robot holds, and gripper poses in the robot's base; needs --charuco.
        camera_on_hand: the camera is on the gripper and the board lies still; needs --output.
        keep_world: keep the camera pose, known from a robot or TF, and find only the table in the
            world of camera and picker path.
        camera: name of the camera, if there are several; the others move along with it.
        dictionary: dictionary of the board's markers.
        output: write the result to this JSON file and leave the recording unchanged.
        force: calibrate even if a picker path, template or clouds are already expressed in the
            present world, or the depth lies more than 10 mm (rms) from the plane found.

    Raises:
        InvalidConfigError: the options contradict each other, or there is no such camera.
        InvalidRecordingError: no table or board is found.
    """
    from clothtrack_capture.amendment import opened_recording, place_of, reported
    from clothtrack_capture.board import Board
    from clothtrack_capture.camera_pose import (
        camera_named,
        place_camera,
        placement_doubt,
        save_placement,
    )

    _refuse_contradictions(
        robot_poses=robot_poses, charuco=charuco, camera_on_hand=camera_on_hand,
        keep_world=keep_world, output=output,
    )  # fmt: skip
    source = opened_recording(recording)
    board = None if charuco is None else Board(*charuco, dictionary=dictionary)
    placement = _placement(
        source, camera_named(source, camera), board, robot_poses,
        camera_on_hand=camera_on_hand, keep_world=keep_world, force=force,
    )  # fmt: skip
    changed = source
    if output is None:
        changed = place_camera(source, placement, force=force)
    else:
        save_placement(Path(output), placement)
    place = place_of(recording)
    lines = [line for name, value in placement.fit.items() for line in _lines(name, value)]
    if output or not source.in_memory:
        lines.append(f"written to             {output or place / 'recording.json'}")
    doubt = placement_doubt(placement)
    doubts = (
        f"{place}: {doubt}: is the plane found the table? Let a bare table fill the picture, or "
        f"give a board with --charuco{' instead of --keep-world' if keep_world else ''}",
    )
    result = Result("\n".join(lines), placement.as_dict(), doubts if doubt else ())
    return reported(recording, changed, result)


def _refuse_contradictions(
    *, robot_poses: object, charuco: object, camera_on_hand: bool, keep_world: bool, output: object
) -> None:
    if keep_world and charuco is not None:
        raise WrongUsageError(
            "give --keep-world or --charuco, not both: the board makes a world of its own"
        )
    if (robot_poses is not None and charuco is None) or (camera_on_hand and output is None):
        raise WrongUsageError(
            "give --charuco with --robot-poses, and --output with --camera-on-hand: a recording's "
            "camera rests"
        )
    if camera_on_hand and robot_poses is None:
        raise WrongUsageError("--camera-on-hand says how --robot-poses are meant; give both")


def _placement(
    source: "Recording",
    camera: "Camera",
    board: "Board | None",
    robot_poses: Path | str | None,
    *,
    camera_on_hand: bool,
    keep_world: bool,
    force: bool,
) -> "CameraPlacement":
    """Return the camera placement by the requested method."""
    from clothtrack_capture.camera_pose import (
        place_by_board,
        place_by_robot,
        place_by_table,
        table_in_world,
    )
    from clothtrack_capture.hand_eye import read_robot_poses

    if keep_world:
        return table_in_world(source, camera, force=force)
    if board is None:
        return place_by_table(source, camera, force=force)
    if robot_poses is None:
        return place_by_board(source, camera, board)
    poses = read_robot_poses(Path(robot_poses))
    return place_by_robot(source, camera, board, poses, camera_on_hand=camera_on_hand)[0]


def _lines(name: str, value: Any) -> list[str]:
    if name != "per_picture":
        return [f"{name:<22} {value}"]
    return [f"  {row['mm']:7.2f} mm {row['deg']:7.3f} deg  {row['picture']}" for row in value]
