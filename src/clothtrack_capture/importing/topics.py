"""Choice of a bag's depth and color topics by their usual names; otherwise the user must choose."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from clothtrack.errors import InvalidRecordingError
from clothtrack_capture.importing.containers import Topic

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
# Best first. Depth that a driver has registered to color needs no registration here.
_DEPTH = (
    r"aligned_depth_to_color/image(_raw|_rect)?$",
    r"depth_to_(rgb|color)/(hw_registered/)?image(_raw|_rect|_rect_raw)?$",
    r"depth_registered/(hw_registered/|sw_registered/)?image(_raw|_rect|_rect_raw)?$",
    r"/device_\d+/sensor_\d+/Depth_\d+/image/data$",
    r"depth/depth_registered$",
    r"depth/(hw_registered/)?image(_rect_raw|_rect|_raw)?$",
    r"depth(_raw|_image)?$",
)
_COLOR = (
    r"/device_\d+/sensor_\d+/Color_\d+/image/data$",
    r"(color|rgb)/image_(raw|color|rect_color|rect)$",
    r"(color|rgb)/image$",
    r"rgb/image_rect_color$",
    r"image_(color|rect_color)$",
    r"(left|camera)/image_(rect_color|raw)$",
)
_TRANSPORTS = ("/compressedDepth", "/compressed")


def base_name(topic: str) -> str:
    """Return the topic name without its image transport."""
    for transport in _TRANSPORTS:
        topic = topic.removesuffix(transport)
    return topic


def _image_topics(topics: Iterable[Topic]) -> list[Topic]:
    """Return the topics that carry pictures."""
    return [topic for topic in topics if topic.kind in (IMAGE, COMPRESSED)]


def choose_depth(path: Path, topics: Sequence[Topic], asked: str | None) -> Topic:
    """Return the topic of depth."""
    # The plain `compressed` of a depth topic can be 8-bit; compressedDepth never is.
    able = [topic for topic in _image_topics(topics) if not topic.name.endswith("/compressed")]
    return _choose(path, able, _DEPTH, asked, what="depth", flag="--depth-topic", every=topics)


def choose_color(
    path: Path, topics: Sequence[Topic], depth: Topic, asked: str | None
) -> Topic | None:
    """Return the topic of color, or None if there is none."""
    able = [
        topic
        for topic in _image_topics(topics)
        if not topic.name.endswith("/compressedDepth") and topic.name != depth.name
    ]
    usual = [
        topic
        for topic in able
        if any(re.search(pattern, base_name(topic.name)) for pattern in _COLOR)
    ]
    if asked is None and not usual:
        return None
    # The color of a camera shares the longest topic prefix with its depth.
    shared = max((_shared(topic.name, depth.name) for topic in usual), default=0)
    near = [topic for topic in able if _shared(topic.name, depth.name) >= shared]
    return _choose(
        path, able if asked else near, _COLOR, asked,
        what="color", flag="--color-topic", every=topics,
    )  # fmt: skip


def info_topic(topics: Iterable[Topic], image: Topic) -> Topic | None:
    """Return the topic with the intrinsics of a picture topic."""
    folder, _, _ = base_name(image.name).rpartition("/")
    stream = folder.removesuffix("/image")
    wanted = (
        f"{folder}/camera_info",
        f"{base_name(image.name)}/camera_info",
        f"{stream}/info/camera_info",
        f"{folder.removesuffix('/hw_registered')}/camera_info",
    )
    known = {topic.name: topic for topic in topics if topic.kind == CAMERA_INFO}
    return next((known[name] for name in wanted if name in known), None)


def listed(topics: Iterable[Topic], limit: int = 30) -> str:
    """Return a list of the topics as text, pictures first."""
    ranked = sorted(
        set(topics), key=lambda topic: (topic.kind not in (IMAGE, COMPRESSED), topic.name)
    )
    words = [f"{topic.name} ({topic.kind.rpartition('/')[2]})" for topic in ranked[:limit]]
    more = [f"and {len(ranked) - limit} more"] if len(ranked) > limit else []
    return ", ".join(words + more) or "none"


def _choose(
    path: Path,
    able: Sequence[Topic],
    patterns: Sequence[str],
    asked: str | None,
    *,
    what: str,
    flag: str,
    every: Sequence[Topic],
) -> Topic:
    if asked is not None:
        candidates = [topic for topic in able if topic.name == asked] or [
            topic for topic in able if base_name(topic.name) == asked
        ]
        if not candidates:
            raise InvalidRecordingError(
                f"{path}: no {what} topic {asked!r}; topics: {listed(every)}; name one with {flag}"
            )
        return candidates[0]
    for pattern in patterns:
        candidates = [topic for topic in able if re.search(pattern, base_name(topic.name))]
        names = {base_name(topic.name) for topic in candidates}
        if len(names) > 1:
            raise InvalidRecordingError(
                f"{path}: {len(names)} topics may be the {what}: {', '.join(sorted(names))}; "
                f"choose one with {flag}"
            )
        if candidates:
            # Of several transports, prefer raw images.
            return min(candidates, key=lambda topic: (topic.kind != IMAGE, topic.name))
    raise InvalidRecordingError(
        f"{path}: no topic has a usual name of {what}; topics: {listed(every)}; name one "
        f"with {flag}"
    )


def _shared(name: str, other: str) -> int:
    count = 0
    for mine, yours in zip(name.split("/"), other.split("/"), strict=False):
        if mine != yours:
            break
        count += 1
    return count
