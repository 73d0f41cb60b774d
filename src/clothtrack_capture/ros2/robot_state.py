"""The tool tip's position and the gripper's state, from poses, TF and gripper messages."""

import logging
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError
from clothtrack_capture.importing.containers import Topic
from clothtrack_capture.importing.messages import decode, grip_of, header_stamp_ns, position_of
from clothtrack_capture.importing.transforms import TransformTree
from clothtrack_capture.ros2.joining import GripTrack, TipTrack
from clothtrack_capture.ros2.source_config import Ros2SourceConfig, Ros2Topics

logger = logging.getLogger(__name__)

PICKER = "picker"
TF_STATIC = "/tf_static"
_TF_KEPT_NS = 5 * 10**9


@dataclass
class RobotState:
    """The robot's state as known so far.

    Attributes:
        config: how long a pose is valid, and when a gripper is closed.
        world: frame of the positions; "" if not specified, and then poses are used unchanged.
    """

    topics: Ros2Topics
    config: Ros2SourceConfig
    world: str = ""
    tree: TransformTree = field(default_factory=TransformTree)
    _tip: TipTrack = field(default_factory=TipTrack)
    _tip_frame: str = ""
    _grip: GripTrack = field(default_factory=GripTrack)
    _lost: str = ""

    def note_pose(self, topic: Topic, data: bytes, sent_ns: int) -> None:
        """Store the tip's position."""
        found = position_of(topic, decode(topic, data))
        if found is not None:
            self._tip_frame, position = found
            self._tip.add(header_stamp_ns(topic, data) or sent_ns, np.array(position))

    def note_transforms(self, topic: Topic, data: bytes, sent_ns: int) -> None:
        """Store the transforms of a TF message."""
        for stamped in decode(topic, data).transforms:
            self.tree.add_message(stamped, sent_ns, static=topic.name == TF_STATIC)

    def note_grip(self, topic: Topic, data: bytes, sent_ns: int) -> None:
        """Store whether the gripper is closed."""
        stamp_ns = header_stamp_ns(topic, data) if topic.kind.startswith("sensor_msgs/") else 0
        told = grip_of(decode(topic, data))
        if not isinstance(told, bool):
            if told is None or self.config.closed_below is None:
                raise InvalidConfigError(
                    f"{topic.name} tells {told}, not closed or open; say below which value the "
                    "gripper is closed: closed_below"
                )
            told = told < self.config.closed_below
        self._grip.add(stamp_ns or sent_ns, told, stamped=bool(stamp_ns))

    @property
    def known_ns(self) -> int | None:
        """Time until which the tip's position is known [ns]; None if no wait is needed."""
        tool = self.topics.tool_frame
        if tool is None:
            return self._tip.known_ns if self.topics.pose is not None else None
        if not self.tree.connects(self.world, tool):
            return -1
        # 0 means that the transform is static, so it is known at any time.
        return int(self.tree.moments(self.world, tool)[-1]) or None

    def picker(
        self, stamp_ns: int, sent_ns: int
    ) -> dict[str, tuple[Float[np.ndarray, " 3"], bool]] | None:
        """Return the tip position in the world [m] and whether it is closed, at a picture's time.

        Args:
            stamp_ns: time in the header of the picture [ns].
            sent_ns: time at which it was sent [ns].
        """
        if self.topics.pose is None and self.topics.tool_frame is None:
            return None
        position = self._tip_at(stamp_ns)
        lost = self._why_lost() if position is None else ""
        if bool(lost) != bool(self._lost):
            logger.warning("the place of the tool is %s", lost or "known again")
        self._lost = lost
        self.tree.forget(stamp_ns - _TF_KEPT_NS)
        return None if position is None else {PICKER: (position, self._grip.at(stamp_ns, sent_ns))}

    def _tip_at(self, stamp_ns: int) -> Float[np.ndarray, " 3"] | None:
        moment, reach_ns = np.array([stamp_ns]), round(self.config.stall_s * 1e9)
        tool = self.topics.tool_frame
        if tool is not None:
            known_ns = self.known_ns
            if known_ns is not None and stamp_ns - known_ns > reach_ns:
                return None
            return self.tree.lookup(self.world, tool, moment)[0, :3, 3]
        position = self._tip.at(stamp_ns, reach_ns)
        if position is None or self._tip_frame == self.world or not self.world:
            return position
        if not self.tree.connects(self.world, self._tip_frame):
            return None
        pose = self.tree.lookup(self.world, self._tip_frame, moment)[0]
        return pose[:3, :3] @ position + pose[:3, 3]

    def _why_lost(self) -> str:
        frame = self._tip_frame if self.topics.tool_frame is None else self.topics.tool_frame
        if self.world and frame and not self.tree.connects(self.world, frame):
            return f"unknown: nothing ties its frame {frame!r} to the world {self.world!r}"
        name = self.topics.pose or f"TF frame {self.topics.tool_frame}"
        return f"unknown: {name} has told nothing for {self.config.stall_s:g} s"
