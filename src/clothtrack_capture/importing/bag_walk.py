"""One pass through a bag that collects the position of every picture and a few other messages."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack_capture.importing.containers import Container, Message, Place, Topic
from clothtrack_capture.importing.import_options import ImportOptions
from clothtrack_capture.importing.messages import decode, lens_words, payload, position_of, stamp_ns
from clothtrack_capture.importing.source import StreamFrame
from clothtrack_capture.importing.topics import CAMERA_INFO, OF_THE_SDK, is_picture
from clothtrack_capture.importing.transforms import TransformTree

_TF_KINDS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_CLOCK_SAMPLES = 200
# A writer's clock that falls behind by more was set back; writing goes on one picture later.
_SET_BACK_NS, _STEP_NS = 10**9, 33_333_333
# Parts of one bag follow each other within this time, and overlap by no more than this.
_PART_GAP_NS, _PART_OVERLAP_NS = 10 * 10**9, 10**9


@dataclass
class Walk:
    """What one pass through a bag finds, by topic name; pictures in the order of writing.

    `infos` and `heard` hold the first message; `changed` says what it does not stand for.
    `poses` are (time [ns], frame, position [m]), `grips` (time [ns], message); `marks` has the
    stamps of the robot's messages, beside their times of writing.
    """

    options: ImportOptions
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
    _gaps_ns: list[int] = field(default_factory=list)
    _info_bytes: dict[str, bytes] = field(default_factory=dict)
    _clocks: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def clock_gap_ns(self) -> int:
        """Write time minus header time [ns], median over the first pictures."""
        return sorted(self._gaps_ns)[len(self._gaps_ns) // 2] if self._gaps_ns else 0

    def _written_ns(self, topic: str, log_ns: int) -> int:
        """Return a time of writing [ns] that goes on where the writer's clock was set back."""
        # Each topic by itself: some programs write one topic after the other.
        latest, shift = self._clocks.get(topic, (log_ns, 0))
        if log_ns + shift < latest - _SET_BACK_NS:
            shift = latest + _STEP_NS - log_ns
        self._clocks[topic] = max(latest, log_ns + shift), shift
        return log_ns + shift

    def note(self, container: Container, message: Message, part: int) -> None:
        """Keep what a message tells; `part` is the index of its file."""
        topic, place = message.topic, message.place._replace(part=part)
        written_ns = self._written_ns(topic.name, message.log_ns)
        wanted = topic.name in (self.options.picker_topic, self.options.gripper_topic)
        stamp = stamp_ns(container, topic, place) if wanted or is_picture(topic) else 0
        time_ns = stamp if stamp and self.options.stamps != "written" else written_ns
        if is_picture(topic):
            if time_ns != written_ns and len(self._gaps_ns) < _CLOCK_SAMPLES:
                self._gaps_ns.append(written_ns - time_ns)
            frame = StreamFrame(time_ns, place, written_ns, stamped=bool(stamp))
            self.frames.setdefault(topic.name, []).append(frame)
        elif not wanted:
            self._note_other(container, topic, place, written_ns)
        if wanted:
            self._mark(topic, StreamFrame(time_ns, None, written_ns, stamped=bool(stamp)))
            content = decode(topic, payload(container, place))
            if topic.name != self.options.picker_topic:
                self.grips.append((time_ns, content))
            elif (found := position_of(topic, content)) is None:
                self.without_position += 1
            else:
                self.poses.append((time_ns, *found))

    def _mark(self, topic: Topic, frame: StreamFrame) -> None:
        self.marks.setdefault(topic.name, []).append(frame)

    def _note_other(self, container: Container, topic: Topic, place: Place, sent_ns: int) -> None:
        if topic.kind == CAMERA_INFO:
            self._note_info(topic, payload(container, place))
        elif topic.kind in _TF_KINDS:
            static, written = "static" in topic.name, self.options.stamps == "written"
            for one in decode(topic, payload(container, place)).transforms:
                time_ns = self.tree.add_message(one, sent_ns, static=static, written=written)
                if not static:
                    self._mark(topic, StreamFrame(time_ns, None, sent_ns))
        elif OF_THE_SDK.match(topic.name):
            content = decode(topic, payload(container, place))
            first = self.heard.setdefault(topic.name, content)
            if getattr(first, "data", None) != getattr(content, "data", None):
                self.changed[topic.name] = f"{first.data} and later {content.data}"

    def _note_info(self, topic: Topic, data: bytes) -> None:
        """Store the first CameraInfo of a topic, and how a later one differs but for its stamp."""
        known = self.infos.get(topic.name)
        # In ROS 1 and in CDR alike, the stamp ends with byte 12.
        if known is None:
            self.infos[topic.name], self._info_bytes[topic.name] = decode(topic, data), data[12:]
        elif data[12:] != self._info_bytes[topic.name] and topic.name not in self.changed:
            info = decode(topic, data)
            if not any(known.k if topic.cdr else known.K):
                self.infos[topic.name] = info  # the driver was not ready before
            elif lens_words(known) != lens_words(info):
                self.changed[topic.name] = f"{lens_words(known)} and later {lens_words(info)}"


def in_time_order(parts: Sequence[Container]) -> list[Container]:
    """Return the parts of a bag by the times of their first messages."""
    if len(parts) < 2:
        return list(parts)
    begun = [(first.log_ns, number) for number, part in enumerate(parts)
             if (first := next(_messages(part), None)) is not None]  # fmt: skip
    return [parts[number] for _, number in sorted(begun)]


def walk(path: Path, parts: Sequence[Container], options: ImportOptions) -> Walk:
    """Read every part of a bag once."""
    result = Walk(options)
    spans: list[tuple[int, int, Path]] = []
    for number, part in enumerate(parts):
        times: list[int] = []
        for message in _messages(part):
            # Other topics may repeat an old message at the start of a part.
            if is_picture(message.topic):
                times.append(message.log_ns)
            try:
                result.note(part, message, number)
            except TruncatedError as error:
                raise InvalidRecordingError(
                    f"{part.path}: a message cannot be read ({error}); name another topic, or "
                    "copy the bag again"
                ) from error
        if times:
            spans.append((min(times), max(times), part.path))
        known = {topic.name for topic in result.topics}
        result.topics += [topic for topic in part.topics.values() if topic.name not in known]
    steps = [start - end for (_, end, _), (start, _, _) in pairwise(spans)]
    sheet = path / "metadata.yaml"  # The recorder lists there the files that are one bag.
    listed = sheet.read_text(errors="replace") if sheet.is_file() else ""
    if not (all(-_PART_OVERLAP_NS <= step <= _PART_GAP_NS for step in steps)
            or all(f"- {file.name}" in listed for *_, file in spans)):  # fmt: skip
        files = "; ".join(f"{file.name}: {first / 1e9:.3f} to {last / 1e9:.3f} s"
                          for first, last, file in spans)  # fmt: skip
        raise InvalidRecordingError(
            f"{path}: {len(spans)} bags that do not follow each other within "
            f"{_PART_GAP_NS / 1e9:.0f} s ({files}); import one file, such as {spans[0][2]}"
        )
    return result


def _messages(container: Container) -> Iterator[Message]:
    try:
        yield from container.messages()
    except TruncatedError as error:
        raise InvalidRecordingError(
            f"{container.path}: the bag breaks off or is damaged ({error}); copy it again, or "
            "repair it with `rosbag reindex`, `ros2 bag reindex` or `mcap recover`"
        ) from error
