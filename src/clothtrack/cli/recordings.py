"""The verbs that check a recording and import one: inspect and import."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from clothtrack.cli.options import AsJson
from clothtrack.cli.terminal import progress, say_result


def inspect(recording: Positional[Path], *, json: AsJson = False) -> int:
    """Is this recording readable? What is in it, what is wrong with it?

    Args:
        recording: folder with a recording.json.
        json: machine-readable.
    """
    from clothtrack.recordings.inspection import inspect as inspect_recording

    found = inspect_recording(recording)
    say_result(found.text(), found.as_dict(), json=json)
    return 0 if found.valid else 1


def import_(
    source: Positional[Path],
    recording: Positional[Path],
    *,
    depth_topic: str | None = None,
    color_topic: str | None = None,
    without_color: bool = False,
    depth_unit_m: float | None = None,
    intrinsics: Path | None = None,
    fps: float | None = None,
    tolerance_s: float | None = None,
    world_from_camera: Path | None = None,
    world_frame: str | None = None,
    picker_csv: Path | None = None,
    picker_clock: Literal["recording", "source"] = "recording",
    picker_topic: str | None = None,
    picker_frame: str | None = None,
    gripper_topic: str | None = None,
    gripper_closed_below: float | None = None,
    actions: tuple[str, ...] = (),
    cloth: Annotated[Literal["towel", "tshirt", "other"], arg(aliases=["--kind"])] = "other",
    cloth_color: str | None = None,
    camera_name: str = "camera",
    workers: int | None = None,
    json: AsJson = False,
) -> int:
    """Make a recording of a ROS bag, a RealSense or Kinect file, or a folder of pictures.

    Reads ROS 2 (.mcap, .db3, folders), ROS 1 and RealSense (.bag, .db3), Azure Kinect and Femto
    (.mkv), and folders in the style of TUM, Open3D and BOP; docs/import.md has a table of each.

    Args:
        source: file or folder.
        recording: folder to write; must not exist.
        depth_topic: topic of depth; found by the usual names.
        color_topic: topic of colour; found by the usual names.
        without_color: import depth alone.
        depth_unit_m: metres per unit of depth, where the source does not say (0.001 = mm).
        intrinsics: JSON file with the lenses, where the source has none.
        fps: pictures per second, for folders without time stamps.
        tolerance_s: how far apart colour and depth may be; half the time between depth pictures
            by default.
        world_from_camera: JSON file with the colour camera's pose in the world, 4 x 4, metres, and
            with the table where `calibrate-camera --output` wrote it.
        world_frame: TF frame that is the world.
        picker_csv: the picker's path: picker.csv, or time,x,y,z[,closed] in seconds and metres.
        picker_clock: clock of that file: 0 is the first frame, or the source's time stamps.
        picker_topic: topic of the picker's tip: PoseStamped, PointStamped, Odometry, ...
        picker_frame: TF frame of the picker's tip.
        gripper_topic: topic that tells when it is closed: Bool, a number, or finger joints.
        gripper_closed_below: closed where that number (joints: their sum) is smaller.
        actions: first and last frame of every action, such as 10-50 60-90; from the gripper by
            default.
        cloth: what is filmed.
        cloth_color: its colour's name, to tell it from the rest.
        camera_name: the camera's name in the recording.
        workers: threads; as many as processors, at most four, by default.
        json: machine-readable.
    """
    from clothtrack.importing.import_recording import ImportConfig, import_recording
    from clothtrack.importing.source import Wanted

    wanted = Wanted(
        depth_topic, color_topic, without_color, depth_unit_m, intrinsics, fps,
        picker_topic, picker_frame, gripper_topic, gripper_closed_below, world_frame,
    )  # fmt: skip
    config = ImportConfig(
        wanted, tolerance_s, picker_csv, picker_clock, actions, world_from_camera, camera_name,
        cloth, cloth_color, workers,
    )  # fmt: skip
    report = import_recording(source, recording, config, progress=progress)
    say_result(report.text(), report.as_dict(), json=json)
    return 0


# The word of the command line is no name of Python's.
import_.__name__ = "import"
