"""What a person says about an import; `clothtrack import` makes its options of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class ImportOptions:
    """What a person says about an import; everything may be left to the source.

    Attributes:
        depth_topic: topic of depth; found by the usual names.
        color_topic: topic of color; found by the usual names.
        without_color: import depth alone.
        depth_unit_m: meters per unit of depth, where the source does not say (0.001 = mm).
        intrinsics: JSON file with the intrinsics, where the source has none.
        fps: pictures per second, for folders without time stamps.
        tolerance_s: how far apart color and depth may be [s]; half the time between depth pictures
            by default.
        world_from_camera: JSON file with the color camera's pose in the world, 4 x 4, meters, and
            with the table where `calibrate-camera --output` wrote it.
        world_frame: TF frame that is the world.
        picker_csv: the picker's path: picker.csv, or time,x,y,z[,closed] in seconds and meters.
        picker_clock: clock of that file: 0 is the first frame, or the source's time stamps.
        picker_topic: topic of the picker's tip: PoseStamped, PointStamped, Odometry, ...
        picker_frame: TF frame of the picker's tip.
        gripper_topic: topic that tells when it is closed: Bool, a number, or finger joints.
        gripper_closed_below: closed where that number (joints: their sum [m]) is smaller.
        actions: first and last frame of every action, such as 10-50 60-90; from the gripper by
            default.
        cloth: what is filmed.
        cloth_color: its color's name, to tell it from the rest.
        workers: threads; as many as processors, at most four, by default.
    """

    depth_topic: str | None = None
    color_topic: str | None = None
    without_color: bool = False
    depth_unit_m: float | None = None
    intrinsics: Path | None = None
    fps: float | None = None
    tolerance_s: float | None = None
    world_from_camera: Path | None = None
    world_frame: str | None = None
    picker_csv: Path | None = None
    picker_clock: Literal["recording", "source"] = "recording"
    picker_topic: str | None = None
    picker_frame: str | None = None
    gripper_topic: str | None = None
    gripper_closed_below: float | None = None
    actions: tuple[str, ...] = ()
    cloth: Literal["towel", "tshirt", "trousers", "other"] = "other"
    cloth_color: str | None = None
    workers: int | None = None
