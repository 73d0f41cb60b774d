"""Which ROS 2 topics a live source reads, and how it joins them."""

from dataclasses import dataclass

import numpy as np

from clothtrack.errors import InvalidConfigError


@dataclass(frozen=True)
class Ros2Topics:
    """Which topics tell what.

    Attributes:
        depth: Image, 16UC1 or 32FC1, registered to color.
        color: Image of the same size, such as rgb8 or bgr8; None for depth alone.
        camera_info: intrinsics of these pictures.
        pose: of the tool's tip: PoseStamped, PoseWithCovarianceStamped, PointStamped,
            TransformStamped or Odometry.
        tool_frame: TF frame of the tool's tip, instead of `pose`.
        gripper: Bool (true is closed), Float32, Float64 or JointState.
        world_frame: TF frame that is the world. None: poses are in the world as they come.
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
    """How messages are read and joined.

    Attributes:
        depth_unit_m: meters per count of 16UC1 [m]; ROS says millimeters (REP 118).
        closed_below: the gripper's number, or sum of joints, below which it is closed.
        tolerance_s: how far apart the stamps of depth and color may be [s].
        hold_s: how long a picture waits for its color and for the pose at its time [s].
        stall_s: how old the pose may be [s]; beyond it the picture comes without a picker.
        patience_s: how long a topic may be silent before an error says so [s].
    """

    depth_unit_m: float = 0.001
    closed_below: float | None = None
    tolerance_s: float = 0.016
    hold_s: float = 0.05
    stall_s: float = 0.2
    patience_s: float = 5.0

    def __post_init__(self) -> None:
        """Refuse what is no time and no unit.

        Raises:
            InvalidConfigError: with the field and its value.
        """
        for name in ("depth_unit_m", "tolerance_s", "hold_s", "stall_s", "patience_s"):
            if not 0 < getattr(self, name) < np.inf:
                raise InvalidConfigError(f"{name} is {getattr(self, name)}; it must be positive")
