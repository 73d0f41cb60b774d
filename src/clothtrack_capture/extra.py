"""Checks for the optional dependencies of this package: the extras [capture] and [ros2]."""

from clothtrack.files.extras import require_extra


def require_capture() -> None:
    """Check that the extra [capture] is installed."""
    require_extra("capture", ("lz4", "mcap", "rosbags", "zstandard"), "importing")


def require_ros2() -> None:
    """Check that the extra [ros2] is installed."""
    require_extra("ros2", ("cyclonedds", "rosbags"), "speaking ROS 2")
