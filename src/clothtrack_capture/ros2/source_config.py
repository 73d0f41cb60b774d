"""A live ROS 2 source: its topics, how they are joined, and the pictures that come of it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.errors import InvalidConfigError


@dataclass(frozen=True)
class Ros2Topics:
    """The topics of a live source.

    Attributes:
        depth: depth Image, 16UC1 or 32FC1, registered to color.
        color: color Image of the same size, such as rgb8 or bgr8; None for depth alone.
        pose: pose of the tool's tip: PoseStamped, PoseWithCovarianceStamped, PointStamped,
            TransformStamped or Odometry.
        tool_frame: TF frame of the tool's tip, instead of `pose`.
        gripper: gripper state: Bool (true is closed), Float32, Float64 or JointState.
        world_frame: TF frame of the world; None if poses are already in the world.
    """

    depth: str = "/camera/aligned_depth_to_color/image_raw"
    color: str | None = "/camera/color/image_raw"
    camera_info: str = "/camera/color/camera_info"
    pose: str | None = None
    tool_frame: str | None = None
    gripper: str | None = None
    world_frame: str | None = None


@dataclass(frozen=True)
class Ros2SourceConfig:
    """Settings for reading and joining messages.

    Attributes:
        depth_unit_m: meters per count of 16UC1 [m]; ROS prescribes millimeters (REP 118).
        closed_below: value of the gripper, or sum of its joints, below which it is closed.
        tolerance_s: largest difference of the stamps of depth and color [s].
        hold_s: how long a picture waits for its color and its pose [s].
        stall_s: largest age of the pose [s]; beyond it the picture is returned without a picker.
        patience_s: longest silence of a topic before an error is raised [s].
    """

    depth_unit_m: float = 0.001
    closed_below: float | None = None
    tolerance_s: float = 0.016
    hold_s: float = 0.05
    stall_s: float = 0.2
    patience_s: float = 5.0

    def __post_init__(self) -> None:
        """Refuse invalid times and units.

        Raises:
            InvalidConfigError: with the field and its value.
        """
        for name in ("depth_unit_m", "tolerance_s", "hold_s", "stall_s", "patience_s"):
            if not 0 < getattr(self, name) < np.inf:
                raise InvalidConfigError(f"{name} is {getattr(self, name)}; it must be positive")


@dataclass(frozen=True, eq=False)
class LivePicture:
    """The data of a camera and a robot at one moment.

    Attributes:
        time_s: seconds since the source's first depth picture.
        depth: depth along the optical axis [m], float32; 0 where nothing was measured.
        color: color picture, red first, registered to depth; None without a color camera.
        mask: true where the picture shows the cloth; None if not known.
        picker: tip position in the world [m] and whether it is closed, per picker name; None if no
            picker is tracked or its pose has stalled.
    """

    time_s: float
    depth: Float[np.ndarray, "height width"]
    color: UInt8[np.ndarray, "height width 3"] | None = None
    mask: Bool[np.ndarray, "height width"] | None = None
    picker: Mapping[str, tuple[Float[np.ndarray, " 3"], bool]] | None = None
