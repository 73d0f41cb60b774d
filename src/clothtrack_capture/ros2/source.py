"""Live pictures and tool poses from ROS 2 topics, joined by time."""

import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidRecordingError, TruncatedError
from clothtrack.geometry.camera import Camera
from clothtrack_capture.importing.containers import Topic
from clothtrack_capture.importing.images import raw_color, raw_depth_m
from clothtrack_capture.importing.intrinsics import Intrinsics
from clothtrack_capture.importing.messages import decode, header_stamp_ns, intrinsics_of
from clothtrack_capture.importing.topics import CAMERA_INFO, IMAGE, base_name, topic_list
from clothtrack_capture.ros2.joining import PictureCounts, PictureQueue, Received
from clothtrack_capture.ros2.participant import Participant, Publication, Reader
from clothtrack_capture.ros2.robot_state import TF_STATIC, RobotState
from clothtrack_capture.ros2.source_config import LivePicture, Ros2SourceConfig, Ros2Topics

logger = logging.getLogger(__name__)

_Found = TypeVar("_Found")

_TF = "/tf"
_TF_KIND = "tf2_msgs/msg/TFMessage"
_KINDS = {
    "depth": (IMAGE,),
    "color": (IMAGE,),
    "camera_info": (CAMERA_INFO,),
    "pose": (
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "geometry_msgs/msg/PointStamped",
        "geometry_msgs/msg/TransformStamped",
        "nav_msgs/msg/Odometry",
    ),
    "gripper": (
        "std_msgs/msg/Bool",
        "std_msgs/msg/Float32",
        "std_msgs/msg/Float64",
        "sensor_msgs/msg/JointState",
    ),
}
# Take pictures first, so that messages sent before a picture are there when it is joined.
_ORDER = ("depth", "color", "camera_info", TF_STATIC, _TF, "pose", "gripper")
_LOOK_AGAIN_S = 0.05
_POLL_S = 0.002


class Ros2Source:
    """A live source of a ROS 2 camera's pictures with the tool's pose; older ones are dropped.

    Iterating yields `LivePicture` objects, whose fields are the input of a live tracker's update.
    Iteration ends when `close` is called, or when depth is no longer published.

    Attributes:
        camera: intrinsics and pose in the world.
        start_ns: stamp of the first depth picture [ns]; times count from it.
        counts: depth pictures that were not returned, by reason.
    """

    camera: Camera
    start_ns: int
    counts: PictureCounts

    def __init__(
        self,
        topics: Ros2Topics = Ros2Topics(),  # noqa: B008
        *,
        world_from_camera: Float[np.ndarray, "4 4"] | None = None,
        config: Ros2SourceConfig = Ros2SourceConfig(),  # noqa: B008
        domain_id: int | None = None,
    ) -> None:
        """Join the domain and wait for the first pictures and the camera's intrinsics and pose."""
        if topics.tool_frame is not None and (topics.pose is not None or not topics.world_frame):
            raise InvalidConfigError(
                f"tool_frame {topics.tool_frame!r} is looked up in TF: give world_frame with it, "
                "and no pose"
            )
        self._config = config
        asked = {part: getattr(topics, part) for part in _KINDS}
        self._names = {part: f"/{name.lstrip('/')}" for part, name in asked.items() if name}
        self._queue = PictureQueue(
            self._names["depth"], with_color="color" in self._names,
            tolerance_s=config.tolerance_s, hold_s=config.hold_s,
        )  # fmt: skip
        self.counts = self._queue.counts
        self._robot = RobotState(topics, config, world=topics.world_frame or "")
        self._first: dict[str, Received] = {}
        self._info: Any = None
        self._readers: dict[str, Reader] = {}
        self._lock, self._closed = threading.Lock(), False
        self._participant = Participant(domain_id)
        try:
            self._find_readers(with_tf=topics.world_frame is not None)
            self._await_first_messages()
            self._intrinsics = self._find_intrinsics()
            frame = self._check_first_pictures()
            pose = self._find_pose(frame) if world_from_camera is None else world_from_camera
            self.camera = self._intrinsics.rectified().camera("camera", pose)
            self.start_ns = self._first["depth"].stamp_ns
            self._queue.counts.late = 0  # pictures that came before now could not have been taken
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "Ros2Source":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __iter__(self) -> Iterator[LivePicture]:
        """Yield pictures as they arrive."""
        while not self._closed:
            alone = self.counts.alone
            picture = self.take(self._config.patience_s)
            if picture is not None:
                yield picture
                continue
            with self._lock:
                if self._closed or self._names["depth"] not in self._participant.publications():
                    return
                raise InvalidRecordingError(self._why_silent(self.counts.alone - alone))

    def take(self, wait_s: float) -> LivePicture | None:
        """Return the newest picture that was not returned yet; older ones are dropped.

        Args:
            wait_s: how long to wait for one [s]. To report a stalled camera, wait for the longest
                acceptable delay of the report, and call again.
        """
        deadline_s = time.monotonic() + wait_s
        while True:
            with self._lock:
                if self._closed:
                    return None
                self._listen()
                picture = self._next_picture()
                left_s = deadline_s - time.monotonic()
                if picture is not None or left_s <= 0:
                    return picture
                self._participant.wait(min(left_s, _POLL_S if self._queue.waits else _LOOK_AGAIN_S))

    def stamp_ns(self, time_s: float) -> int:
        """Return the header stamp [ns] of the picture at this time [s]."""
        return self.start_ns + round(time_s * 1e9)

    def close(self) -> None:
        """Leave the domain; a thread that waits for a picture gets None."""
        self._closed = True
        with self._lock:
            self._readers.clear()
            self._participant.close()

    def _find_readers(self, *, with_tf: bool) -> None:
        def published() -> dict[str, Publication] | None:
            found = self._participant.publications()
            return found if set(self._names.values()) <= set(found) else None

        found = self._await(published, lambda: self._silence(self._names))
        for part, name in self._names.items():
            publication = found[name]
            if publication.kind not in _KINDS[part]:
                raise InvalidConfigError(
                    f"{name} is of type {publication.kind}; {part} is one of "
                    f"{', '.join(_KINDS[part])}"
                )
            topic = Topic(name, publication.kind, cdr=True)
            self._readers[part] = (
                self._participant.picture_reader(topic)
                if publication.kind == IMAGE
                else self._participant.sample_reader(
                    topic, reliable=publication.reliable, latched=publication.latched
                )
            )
        if with_tf:
            for name, latched in ((_TF, False), (TF_STATIC, True)):
                self._readers[name] = self._participant.sample_reader(
                    Topic(name, _TF_KIND, cdr=True), reliable=latched, latched=latched
                )

    def _await_first_messages(self) -> None:
        wanted = [part for part in ("depth", "color", "camera_info") if part in self._readers]

        def silent() -> list[str]:
            heard = {*self._first, *(["camera_info"] if self._info is not None else [])}
            return [part for part in wanted if part not in heard]

        self._await(lambda: None if silent() else True, lambda: self._silence(silent()))
        del self._readers["camera_info"]

    def _find_intrinsics(self) -> Intrinsics:
        shown = self._names.get("color", self._names["depth"])
        rectified = "rect" in base_name(shown).rpartition("/")[2]
        return intrinsics_of(self._names["camera_info"], self._info, rectified=rectified)

    def _check_first_pictures(self) -> str:
        """Refuse pictures that cannot be decoded or differ in size from the intrinsics."""
        frame = ""
        for part in (part for part in ("depth", "color") if part in self._names):
            try:
                _, frame = self._decoded(part, self._first[part])
            except TruncatedError as error:
                raise InvalidRecordingError(
                    f"{self._names[part]}: {error}; name the depth that the driver registers to "
                    "color, raw and not compressed, and the camera_info of color"
                ) from error
        return frame

    def _find_pose(self, frame: str) -> Float[np.ndarray, "4 4"]:
        """Return the camera pose from TF; the camera's frame is the world if none is given."""
        world, tree = self._robot.world, self._robot.tree
        if not world:
            self._robot.world = frame
            return np.eye(4)
        self._await(
            lambda: True if tree.connects(world, frame) else None,
            lambda: (
                f"no TF tied the camera's frame {frame!r} to world_frame {world!r} in "
                f"{self._config.patience_s:g} s; frames: {', '.join(tree.frames) or 'none'}; give "
                "world_from_camera, or name another frame"
            ),
        )
        return tree.lookup(world, frame, np.array([self._first["depth"].stamp_ns]))[0]

    def _await(self, ready: Callable[[], _Found | None], problem: Callable[[], str]) -> _Found:
        """Listen until `ready` returns a value; otherwise raise an error that names the problem."""
        deadline_s = time.monotonic() + self._config.patience_s
        while True:
            self._listen()
            found = ready()
            if found is not None:
                return found
            if time.monotonic() > deadline_s:
                raise InvalidRecordingError(problem())
            self._participant.wait(_LOOK_AGAIN_S / 5)

    def _silence(self, parts: Iterable[str]) -> str:
        """Return a message that lists silent topics, unpublished first, and existing topics."""
        seen = self._participant.publications()
        names = [self._names[part] for part in parts]
        names = [name for name in names if name not in seen] or names
        topics = topic_list(Topic(name, one.kind, cdr=True) for name, one in seen.items())
        return (
            f"no message on {', '.join(names)} for {self._config.patience_s:g} s; topics seen: "
            f"{topics}; check the names, ROS_DOMAIN_ID and CYCLONEDDS_URI"
        )

    def _why_silent(self, alone: int) -> str:
        if not alone:
            return self._silence(["depth"])
        return (
            f"{alone} pictures of {self._names['depth']} came in {self._config.patience_s:g} s, "
            f"none with a picture of {self._names['color']} within {self._config.tolerance_s:g} s; "
            "raise tolerance_s, or take depth alone (color=None)"
        )

    def _listen(self) -> None:
        """Take every message that has arrived."""
        now_s = time.monotonic()
        for part in _ORDER:
            reader = self._readers.get(part)
            if reader is None:
                continue
            for data, sent_ns in reader.take():
                try:
                    self._note(part, reader.topic, data, sent_ns, now_s)
                except TruncatedError as error:
                    logger.warning("%s: a message is left out (%s)", reader.topic.name, error)

    def _note(self, part: str, topic: Topic, data: bytes, sent_ns: int, now_s: float) -> None:
        if part in ("depth", "color"):
            received = Received(header_stamp_ns(topic, data) or sent_ns, sent_ns, now_s, data)
            self._first.setdefault(part, received)
            (self._queue.add_depth if part == "depth" else self._queue.add_color)(received)
        elif part == "camera_info":
            self._info = decode(topic, data)
        elif part == "pose":
            self._robot.note_pose(topic, data, sent_ns)
        elif part == "gripper":
            self._robot.note_grip(topic, data, sent_ns)
        else:
            self._robot.note_transforms(topic, data, sent_ns)

    def _next_picture(self) -> LivePicture | None:
        while True:
            pair = self._queue.next(time.monotonic(), self._robot.known_ns)
            if pair is None:
                return None
            depth, color = pair
            try:
                return LivePicture(
                    (depth.stamp_ns - self.start_ns) / 1e9,
                    self._decoded("depth", depth)[0],
                    None if color is None else self._decoded("color", color)[0],
                    picker=self._robot.picker(depth.stamp_ns, depth.sent_ns),
                )
            except TruncatedError as error:
                self.counts.damaged += 1
                logger.warning("%s: a picture is left out (%s)", self._names["depth"], error)

    def _decoded(self, part: str, received: Received) -> tuple[np.ndarray, str]:
        """Return an undistorted picture and its frame."""
        message = decode(Topic(self._names[part], IMAGE, cdr=True), received.data)
        depth = part == "depth"
        picture = raw_depth_m(message, self._config.depth_unit_m) if depth else raw_color(message)
        height, width = picture.shape[:2]
        if (width, height) != self._intrinsics.size:
            expected = "{} x {}".format(*self._intrinsics.size)
            raise TruncatedError(
                f"{width} x {height} pixels, but {self._names['camera_info']} says {expected}"
            )
        straight = self._intrinsics.straighten(picture, nearest=depth)
        return straight, str(message.header.frame_id).lstrip("/")
