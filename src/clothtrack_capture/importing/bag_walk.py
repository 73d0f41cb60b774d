"""One pass through a bag that collects the position of every picture and a few other messages."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack_capture.importing import bag_container, mcap_container, sqlite_container
from clothtrack_capture.importing import realsense_bag as realsense
from clothtrack_capture.importing.containers import Container, Message, Place, Topic
from clothtrack_capture.importing.messages import decode, lens_words, payload, position_of, stamp_ns
from clothtrack_capture.importing.source import StreamFrame
from clothtrack_capture.importing.topics import CAMERA_INFO, is_picture
from clothtrack_capture.importing.transforms import TransformTree

_CONTAINERS = (
    (bag_container.MAGIC, bag_container.BagContainer, "ROS 1 bag"),
    (mcap_container.MAGIC, mcap_container.McapContainer, "MCAP"),
    (sqlite_container.MAGIC, sqlite_container.SqliteContainer, "ROS 2 bag (SQLite)"),
)
_TF_KINDS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_CLOCK_SAMPLES = 200
# A writer's clock that falls behind by more was set back; writing goes on one picture later.
_SET_BACK_NS, _STEP_NS = 10**9, 33_333_333
# Parts of one bag follow each other within this time, and overlap by no more than this.
_PART_GAP_NS, _PART_OVERLAP_NS = 10 * 10**9, 10**9


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
    """What one pass through a bag finds, by topic name; pictures in the order of writing.

    `infos` and `heard` hold the first message; `changed` says what it does not stand for.
    `poses` are (time [ns], frame, position [m]), `grips` (time [ns], message); `marks` has the
    stamps of the robot's messages, beside their times of writing.
    """

    pose_topic: str | None = None
    grip_topic: str | None = None
    written: bool = False
    topics: list[Topic] = field(default_factory=list)
    frames: dict[str, list[StreamFrame]] = field(default_factory=dict)
    infos: dict[str, Any] = field(default_factory=dict)
    changed: dict[str, str] = field(default_factory=dict)
    heard: dict[str, Any] = field(default_factory=dict)
    tree: TransformTree = field(default_factory=TransformTree)
    poses: list[tuple[int, str, tuple[float, float, float]]] = field(default_factory=list)
    grips: list[tuple[int, Any]] = field(default_factory=list)
    marks: dict[str, list[StreamFrame]] = field(default_factory=dict)
    without_position: int = 0
    gaps_ns: list[int] = field(default_factory=list)
    info_bytes: dict[str, bytes] = field(default_factory=dict)
    _clocks: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def clock_gap_ns(self) -> int:
        """Write time minus header time [ns], median over the first pictures."""
        return sorted(self.gaps_ns)[len(self.gaps_ns) // 2] if self.gaps_ns else 0

    def written_ns(self, topic: str, log_ns: int) -> int:
        """Return a time of writing [ns] that goes on where the writer's clock was set back."""
        # Each topic by itself: some programs write one topic after the other.
        latest, shift = self._clocks.get(topic, (log_ns, 0))
        if log_ns + shift < latest - _SET_BACK_NS:
            shift = latest + _STEP_NS - log_ns
        self._clocks[topic] = max(latest, log_ns + shift), shift
        return log_ns + shift


def in_time_order(containers: Sequence[Container]) -> list[Container]:
    """Return the parts of a bag by the times of their first messages."""
    if len(containers) < 2:
        return list(containers)
    first = {id(one): next(_messages(one), None) for one in containers}
    begun = [one for one in containers if first[id(one)] is not None]
    return sorted(begun, key=lambda one: getattr(first[id(one)], "log_ns", 0))


def walk(
    path: Path, containers: Sequence[Container], *, pose_topic: str | None, grip_topic: str | None,
    written: bool,
) -> Walk:  # fmt: skip
    """Read every part of a bag once."""
    result = Walk(pose_topic, grip_topic, written)
    spans: list[tuple[int, int, Container]] = []
    for part, container in enumerate(containers):
        times: list[int] = []
        for message in _messages(container):
            # Other topics may repeat an old message at the start of a part.
            if is_picture(message.topic):
                times.append(message.log_ns)
            try:
                _note(result, container, message, part)
            except TruncatedError as error:
                raise InvalidRecordingError(
                    f"{container.path}: a message cannot be read ({error}); name another topic, or "
                    "copy the bag again"
                ) from error
        if times:
            spans.append((min(times), max(times), container))
        known = {topic.name for topic in result.topics}
        result.topics += [topic for topic in container.topics() if topic.name not in known]
    if not _is_listed(path, spans) and not all(
        -_PART_OVERLAP_NS <= start - end <= _PART_GAP_NS
        for (_, end, _), (start, _, _) in pairwise(spans)
    ):
        files = "; ".join(
            f"{container.path.name}: {first / 1e9:.3f} to {last / 1e9:.3f} s"
            for first, last, container in spans
        )
        raise InvalidRecordingError(
            f"{path}: {len(spans)} bags that do not follow each other within "
            f"{_PART_GAP_NS / 1e9:.0f} s ({files}); import one file, such as "
            f"{spans[0][2].path}"
        )
    return result


def _is_listed(path: Path, spans: Sequence[tuple[int, int, Container]]) -> bool:
    """Return whether the recorder says that the files are parts of one bag."""
    file = path / "metadata.yaml"
    text = file.read_text(errors="replace") if file.is_file() else ""
    return all(f"- {container.path.name}" in text for _, _, container in spans)


def _messages(container: Container) -> Iterator[Message]:
    try:
        yield from container.messages()
    except TruncatedError as error:
        raise InvalidRecordingError(
            f"{container.path}: the bag breaks off or is damaged ({error}); copy it again, or "
            "repair it with `rosbag reindex`, `ros2 bag reindex` or `mcap recover`"
        ) from error


def _note(result: Walk, container: Container, message: Message, part: int) -> None:
    topic, place = message.topic, message.place._replace(part=part)
    written_ns = result.written_ns(topic.name, message.log_ns)
    wanted = topic.name in (result.pose_topic, result.grip_topic)
    stamp = stamp_ns(container, topic, place) if wanted or is_picture(topic) else 0
    time_ns = stamp if stamp and not result.written else written_ns
    if is_picture(topic):
        if time_ns != written_ns and len(result.gaps_ns) < _CLOCK_SAMPLES:
            result.gaps_ns.append(written_ns - time_ns)
        frame = StreamFrame(time_ns, place, written_ns, stamped=bool(stamp))
        result.frames.setdefault(topic.name, []).append(frame)
    elif not wanted:
        _note_other(result, container, topic, place, written_ns)
    if wanted:
        _mark(result, topic, StreamFrame(time_ns, None, written_ns, stamped=bool(stamp)))
        content = decode(topic, payload(container, place))
        if topic.name != result.pose_topic:
            result.grips.append((time_ns, content))
        elif (found := position_of(topic, content)) is None:
            result.without_position += 1
        else:
            result.poses.append((time_ns, *found))


def _note_other(
    result: Walk, container: Container, topic: Topic, place: Place, written_ns: int
) -> None:
    if topic.kind == CAMERA_INFO:
        _note_info(result, topic, payload(container, place))
    elif topic.kind in _TF_KINDS:
        static = "static" in topic.name
        for stamped in decode(topic, payload(container, place)).transforms:
            time_ns = result.tree.add_message(
                stamped, written_ns, static=static, written=result.written
            )
            if not static:
                _mark(result, topic, StreamFrame(time_ns, None, written_ns))
    elif realsense.WANTED.match(topic.name):
        content = decode(topic, payload(container, place))
        first = result.heard.setdefault(topic.name, content)
        if getattr(first, "data", None) != getattr(content, "data", None):
            result.changed[topic.name] = f"{first.data} and later {content.data}"


def _mark(result: Walk, topic: Topic, frame: StreamFrame) -> None:
    result.marks.setdefault(topic.name, []).append(frame)


def _note_info(result: Walk, topic: Topic, data: bytes) -> None:
    """Store the first CameraInfo of a topic, and how a later one differs but for its stamp."""
    # In ROS 1 and in CDR alike, the stamp ends with byte 12.
    if result.infos.get(topic.name) is None:
        result.infos[topic.name] = decode(topic, data)
        result.info_bytes[topic.name] = data[12:]
    elif data[12:] != result.info_bytes[topic.name] and topic.name not in result.changed:
        first, later = (lens_words(info) for info in (result.infos[topic.name],
                                                      decode(topic, data)))  # fmt: skip
        if not any(result.infos[topic.name].k if topic.cdr else result.infos[topic.name].K):
            result.infos[topic.name] = decode(topic, data)  # the driver was not ready before
        elif first != later:
            result.changed[topic.name] = f"{first} and later {later}"


def frame_of(container: Container, topic: Topic, place: Place) -> str:
    """Return the frame in the header of a picture; "" if it has none."""
    with suppress(TruncatedError):
        data = payload(container, place)[:512]
        order = "little" if not topic.cdr or data[1:2] == b"\x01" else "big"
        length = int.from_bytes(data[12:16], order)
        if 0 < length <= 256:
            return data[16 : 16 + length].split(b"\0")[0].decode("utf-8", "replace").lstrip("/")
    return ""
