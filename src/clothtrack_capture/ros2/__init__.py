"""ROS 2 input and output over DDS without a ROS installation (extra [ros2])."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names
from clothtrack.files.extras import require_extra

if TYPE_CHECKING:
    from clothtrack_capture.ros2.sink import Ros2Sink
    from clothtrack_capture.ros2.source import Ros2Source
    from clothtrack_capture.ros2.source_config import LivePicture, Ros2SourceConfig, Ros2Topics
else:
    _get, __dir__ = lazy_names(__name__)

    def __getattr__(name: str) -> object:
        if name in __all__:
            require_extra("ros2", ("cyclonedds", "rosbags"), "speaking ROS 2")
        return _get(name)


__all__ = [
    "LivePicture",
    "Ros2Sink",
    "Ros2Source",
    "Ros2SourceConfig",
    "Ros2Topics",
]
