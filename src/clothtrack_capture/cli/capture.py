"""The verbs of setting up a recording: where its camera is, and what is cloth."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from clothtrack.cli.options import AsJson
from clothtrack.cli.terminal import complain, say, say_result

if TYPE_CHECKING:
    from clothtrack.recordings.recording import Recording
    from clothtrack_capture.board import Board
    from clothtrack_capture.camera_pose import CameraPlacement

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
    keep_world: bool = False,
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
        keep_world: the camera's pose is known, from a robot or TF: find the table alone, in the
            world that camera and picker path stand in.
        output: write the result to this JSON file, and leave the recording as it is.
        force: although a picker path, template or clouds stand in the present world already, or
            the depth lies more than 10 mm (rms) from the plane found.
        json: machine-readable.
    """
    from clothtrack.recordings.store import read_recording
    from clothtrack_capture.camera_pose import (
        camera_named,
        place_by_board,
        place_by_table,
        table_in_world,
    )

    if keep_world and charuco is not None:
        complain("give --keep-world or --charuco, not both: the board makes a world of its own")
        return 2
    source = read_recording(recording)
    chosen = camera_named(source, camera)
    board = _board(charuco, dictionary)
    if keep_world:
        placement = table_in_world(source, chosen, force=force)
    elif board is None:
        placement = place_by_table(source, chosen, force=force)
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
    from clothtrack.recordings.store import read_recording
    from clothtrack_capture.camera_pose import camera_named, place_by_robot
    from clothtrack_capture.hand_eye import read_robot_poses

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


def segment(
    recording: Positional[Path],
    *,
    click: Annotated[tuple[int, int] | None, arg(metavar="COLUMN ROW")] = None,
    box: Annotated[tuple[int, int, int, int] | None, arg(metavar="LEFT TOP RIGHT BOTTOM")] = None,
    frame: int = 0,
    camera: str = "",
    keep: bool = False,
    sheet: Path = Path("masks.png"),
    port: int | None = None,
    json: AsJson = False,
) -> int:
    """Show which pixels are cloth, by one click or box: on a page, or with --click or --box.

    Args:
        recording: folder with a recording.json and colour pictures.
        click: on the cloth; without it and without a box a page opens on this machine.
        box: around the cloth.
        frame: in which both are given.
        camera: whose pictures, when there are several.
        keep: write the masks into the recording; on the page there is a button for it.
        sheet: with a click or box, write a picture of masks from all over the recording here.
        port: of the page's server, which listens on this machine only; any free one by default.
        json: machine-readable; the page's address is then on standard error.
    """
    from clothtrack.recordings.store import read_recording
    from clothtrack_capture.camera_pose import camera_named
    from clothtrack_capture.mask_summary import summary_of
    from clothtrack_capture.segmentation_setup import SegmentationSetup

    if click is not None and box is not None:
        complain("give --click or --box, not both")
        return 2
    source = read_recording(recording)
    setup = SegmentationSetup(source, camera_named(source, camera))
    if click is None and box is None:
        from clothtrack_capture.segmentation_page import segment_live

        tell = complain if json else say
        kept = segment_live(
            setup, port, opened=lambda at: tell(f"choose the cloth: {at}   Ctrl-C ends")
        )
        if kept is None:
            say_result("nothing was kept", {"masks": 0, "recording": recording}, json=json)
            return 0
        lines = []
    else:
        from clothtrack_capture.mask_pictures import write_mask_sheet

        if click is not None:
            setup.choose_click(frame, click)
        elif box is not None:
            setup.choose_box(frame, box)
        lines = [f"{write_mask_sheet(setup, sheet)}   (look at it)"]
        kept = setup.keep() if keep else 0
    if kept:
        lines.append(f"{kept} masks are in {recording}")
    summary = summary_of(setup)
    report = {**summary.as_dict(), "masks": kept, "recording": recording}
    say_result("\n".join([str(summary), *lines]), report, json=json)
    return 0


def record(
    output: Positional[Path],
    *,
    seconds: float | None = None,
    replay: Path | None = None,
    width: int = 640,
    height: int = 480,
    rate: int = 30,
    serial: str = "",
    salvage: bool = False,
    port: int | None = None,
    json: AsJson = False,
) -> int:
    """Record from a RealSense camera, with a page that shows the picture and says what to do.

    Args:
        output: folder of the recording; must not exist.
        seconds: record this long at once, without the page.
        replay: a recording that stands in for the camera.
        width: of the pictures [pixels].
        height: of the pictures [pixels].
        rate: pictures per second.
        serial: number of the camera, when several are connected.
        salvage: record nothing; make a recording of what a broken capture has left.
        port: of the page's server, which listens on this machine only; any free one by default.
        json: machine-readable; the page's address is then on standard error.
    """
    from clothtrack.recordings.store import read_recording
    from clothtrack_capture.live_capture import ReplayedCamera, salvage_capture
    from clothtrack_capture.realsense_camera import open_realsense
    from clothtrack_capture.recording_page import Session, record_live

    if salvage:
        saved = salvage_capture(output)
        return _recorded(output, saved, json=json)
    if replay is not None:
        source = ReplayedCamera(read_recording(replay))
    else:
        source = open_realsense(width=width, height=height, rate=rate, serial=serial)
    camera = "a replayed recording" if replay is not None else "RealSense"
    session = Session(source, output, {"recorded_with": f"clothtrack record, {camera}"})
    if seconds is not None:
        session.start()
        with suppress(KeyboardInterrupt):
            session.watch(seconds)
        recording = session.finish()
    else:
        tell = complain if json else say
        recording = record_live(
            session, port, opened=lambda at: tell(f"record at: {at}   Ctrl-C ends")
        )
    if recording is None:
        complain("left before the start; nothing was recorded")
        return 0
    return _recorded(output, recording, json=json)


def _recorded(output: Path, recording: "Recording", *, json: bool) -> int:
    """Say what was recorded."""
    count = len(recording.frames)
    say_result(f"{output}   ({count} frames)", {"recording": output, "frames": count}, json=json)
    return 0


def written(folder: Path) -> str:
    """What says where a picker's path went."""
    return f"written to {folder / 'picker.csv'} and {folder / 'recording.json'}"


def _board(charuco: tuple[int, int, float, float] | None, dictionary: str) -> "Board | None":
    from clothtrack_capture.board import Board

    return None if charuco is None else Board(*charuco, dictionary=dictionary)


def _placed(
    folder: Path, placement: "CameraPlacement", output: Path | None, *, force: bool, json: bool
) -> int:
    """Save a placement where it was wanted, and say what it is."""
    from clothtrack.recordings.store import read_recording
    from clothtrack_capture.camera_pose import place_camera, placement_doubt, save_placement

    if output is not None:
        save_placement(output, placement)
    else:
        place_camera(read_recording(folder), placement, force=force)
    lines = []
    for name, value in placement.fit.items():
        if name == "per_picture":
            lines += [
                f"  {row['mm']:7.2f} mm {row['deg']:7.3f} deg  {row['picture']}" for row in value
            ]
        else:
            lines.append(f"{name:<22} {value}")
    lines.append(f"written to             {output or folder / 'recording.json'}")
    say_result("\n".join(lines), placement.as_dict(), json=json)
    if doubt := placement_doubt(placement):
        complain(
            f"{folder}: {doubt}: is the plane found the table? Let a bare table fill the picture, "
            "or give a board with --charuco"
        )
    return 0
