"""Options of an import; they become the options of `clothtrack import`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class ImportOptions:
    """The options of an import, all of which may be left to the source.

    Attributes:
        depth_topic: topic of depth; found by the usual names by default.
        color_topic: topic of color; found by the usual names by default.
        without_color: import depth alone.
        depth_unit_m: meters per unit of depth, if the source does not say (0.001 = mm).
        intrinsics: JSON file with width, height, fx, fy, cx, cy, if the source has none.
        fps: pictures per second, for folders without time stamps.
        stamps: time of a picture: the stamp in its header, or when it was written.
        color_offset_s: time to add to the stamps of color [s], if it has a clock of its own.
        tolerance_s: largest time difference of color and depth [s]; half the time between depth
            pictures by default.
        world_from_camera: JSON file with the color camera's pose in the world, 4 x 4, meters, and
            with the table if `calibrate-camera --output` wrote one.
        world_frame: TF frame of the world.
        picker_csv: CSV file of the picker's path: picker.csv, or time,x,y,z[,closed] in seconds and
            meters.
        picker_clock: clock of that file: zero at the first frame, or the source's time stamps.
        picker_topic: topic of the picker's tip: PoseStamped, PointStamped, Odometry, ...
        picker_frame: TF frame of the picker's tip.
        gripper_topic: topic of the gripper's state: Bool, a number, or finger joints.
        gripper_joints: joints of the gripper in that topic, if their names do not tell.
        gripper_closed_below: value below which that number (joints: their sum [m]) means closed.
        actions: first and last frame of every action, such as 10-50 60-90, if not the gripper's.
        cloth: kind of cloth in the recording.
        cloth_color: name of the cloth's color, for segmentation.
        workers: number of threads; by default the number of processors, at most four.
    """

    depth_topic: str | None = None
    color_topic: str | None = None
    without_color: bool = False
    depth_unit_m: float | None = None
    intrinsics: Path | None = None
    fps: float | None = None
    stamps: Literal["header", "written"] = "header"
    color_offset_s: float | None = None
    tolerance_s: float | None = None
    world_from_camera: Path | None = None
    world_frame: str | None = None
    picker_csv: Path | None = None
    picker_clock: Literal["recording", "source"] = "recording"
    picker_topic: str | None = None
    picker_frame: str | None = None
    gripper_topic: str | None = None
    gripper_joints: tuple[str, ...] = ()
    gripper_closed_below: float | None = None
    actions: tuple[str, ...] = ()
    cloth: Literal["towel", "tshirt", "trousers", "other"] = "other"
    cloth_color: str | None = None
    workers: int | None = None
