"""One pass through a bag that collects the position of every picture and a few other messages."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack_capture.importing import bag_container, mcap_container, sqlite_container
from clothtrack_capture.importing import realsense_bag as realsense
from clothtrack_capture.importing.containers import Container, Message, Place, Topic
from clothtrack_capture.importing.messages import decode, payload, position_of, stamp_ns
from clothtrack_capture.importing.source import StreamFrame
from clothtrack_capture.importing.topics import CAMERA_INFO, COMPRESSED, IMAGE
from clothtrack_capture.importing.transforms import TransformTree

_CONTAINERS = (
    (bag_container.MAGIC, bag_container.BagContainer, "ROS 1 bag"),
    (mcap_container.MAGIC, mcap_container.McapContainer, "MCAP"),
    (sqlite_container.MAGIC, sqlite_container.SqliteContainer, "ROS 2 bag (SQLite)"),
)
_TF_KINDS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_CLOCK_SAMPLES = 200


def is_bag(path: Path) -> bool:
    """Return whether a file starts like one of the supported bags."""
    return _container_of(path) is not None


def open_parts(paths: Sequence[Path]) -> tuple[list[Container], str]:
    """Return the containers of a bag in one or several files, and the name of the format."""
    containers: list[Container] = []
    words = ""
    try:
        for path in paths:
            kind = _container_of(path)
            if kind is None:
                raise InvalidRecordingError(
                    f"{path}: neither a ROS 1 bag, nor MCAP, nor SQLite; record or copy it again"
                )
            containers.append(kind[0](path))
            words = kind[1]
    except InvalidRecordingError:
        for container in containers:
            container.close()
        raise
    return containers, words


def _container_of(path: Path) -> tuple[type, str] | None:
    try:
        with path.open("rb") as file:
            start = file.read(16)
    except OSError as error:
        raise InvalidRecordingError(f"{path}: {error.strerror}; check the name") from error
    for magic, kind, words in _CONTAINERS:
        if start.startswith(magic):
            return kind, words
    return None


@dataclass
class Walk:
    """The result of one pass through a bag.

    Attributes:
        pose_topic: topic of the picker's pose, if requested.
        grip_topic: topic of the gripper, if requested.
        topics: every topic.
        frames: pictures per topic name.
        infos: first CameraInfo per topic name.
        heard: first message per topic name of the SDK's options and poses.
        tree: TF.
        poses: (time [ns], frame, position [m]) from the pose topic.
        grips: (time [ns], message) from the gripper topic; times as in headers.
        gaps_ns: write time minus header time of the first pictures [ns].
    """

    pose_topic: str | None = None
    grip_topic: str | None = None
    topics: list[Topic] = field(default_factory=list)
    frames: dict[str, list[StreamFrame]] = field(default_factory=dict)
    infos: dict[str, Any] = field(default_factory=dict)
    heard: dict[str, Any] = field(default_factory=dict)
    tree: TransformTree = field(default_factory=TransformTree)
    poses: list[tuple[int, str, tuple[float, float, float]]] = field(default_factory=list)
    grips: list[tuple[int, Any]] = field(default_factory=list)
    gaps_ns: list[int] = field(default_factory=list)

    @property
    def clock_gap_ns(self) -> int:
        """Write time minus header time [ns], median over the first pictures."""
        return sorted(self.gaps_ns)[len(self.gaps_ns) // 2] if self.gaps_ns else 0


def walk(
    containers: Sequence[Container], *, pose_topic: str | None, grip_topic: str | None
) -> Walk:
    """Read every part of a bag once."""
    result = Walk(pose_topic, grip_topic)
    for part, container in enumerate(containers):
        for message in _messages(container):
            try:
                _note(result, container, message, part)
            except TruncatedError as error:
                raise InvalidRecordingError(
                    f"{container.path}: a message cannot be read ({error}); name another topic, or "
                    "copy the bag again"
                ) from error
        known = {topic.name for topic in result.topics}
        result.topics += [topic for topic in container.topics() if topic.name not in known]
    return result


def _messages(container: Container) -> Iterator[Message]:
    try:
        yield from container.messages()
    except TruncatedError as error:
        raise InvalidRecordingError(
            f"{container.path}: the bag breaks off or is damaged ({error}); copy it again, or "
            "repair it with `rosbag reindex`, `ros2 bag reindex` or `mcap recover`"
        ) from error


def _note(result: Walk, container: Container, message: Message, part: int) -> None:
    topic, log_ns, place = message.topic, message.log_ns, message.place._replace(part=part)
    if topic.kind in (IMAGE, COMPRESSED):
        time_ns = stamp_ns(container, topic, place, log_ns)
        if len(result.gaps_ns) < _CLOCK_SAMPLES:
            result.gaps_ns.append(log_ns - time_ns)
        result.frames.setdefault(topic.name, []).append(StreamFrame(time_ns, place))
    elif topic.kind == CAMERA_INFO and topic.name not in result.infos:
        result.infos[topic.name] = decode(topic, payload(container, place))
    elif topic.kind in _TF_KINDS:
        for stamped in decode(topic, payload(container, place)).transforms:
            result.tree.add_message(stamped, log_ns, static="static" in topic.name)
    elif realsense.WANTED.match(topic.name) and topic.name not in result.heard:
        result.heard[topic.name] = decode(topic, payload(container, place))
    if topic.name == result.pose_topic:
        _pose(result, container, message, place)
    if topic.name == result.grip_topic:
        time_ns = stamp_ns(container, topic, place, log_ns)
        result.grips.append((time_ns, decode(topic, payload(container, place))))


def _pose(result: Walk, container: Container, message: Message, place: Place) -> None:
    topic = message.topic
    content = decode(topic, payload(container, place))
    time_ns = stamp_ns(container, topic, place, message.log_ns)
    result.poses.append((time_ns, *position_of(topic, content)))


def frame_of(container: Container, topic: Topic, place: Place) -> str:
    """Return the frame in the header of a picture; "" if it has none."""
    with suppress(TruncatedError):
        data = payload(container, place)[:512]
        order = "little" if not topic.cdr or data[1:2] == b"\x01" else "big"
        length = int.from_bytes(data[12:16], order)
        if 0 < length <= 256:
            return data[16 : 16 + length].split(b"\0")[0].decode("utf-8", "replace").lstrip("/")
    return ""
