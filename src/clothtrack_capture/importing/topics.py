"""Choice of a bag's depth and color topics by their usual names; otherwise the user must choose."""

import re
from collections.abc import Callable, Iterable, Sequence
from itertools import takewhile
from pathlib import Path

from clothtrack.errors import InvalidRecordingError
from clothtrack_capture.importing.containers import Topic
from clothtrack_capture.importing.images import DEPTH_ENCODINGS, GRAY_ENCODINGS

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
_GRAY = re.compile(r"infra|(^|[/_])ir([/_\d]|$)|mono|mask|label", re.IGNORECASE)
# The RealSense SDK names a stream's topics `/device_0/sensor_0/Depth_0/...`.
SDK_STREAM = re.compile(r"^(/device_\d+/sensor_\d+)/[A-Za-z]+_\d+/image/data$")
OF_THE_SDK = re.compile(
    r"^/device_\d+/sensor_\d+/(option/Depth[ _]Units/value|[A-Za-z]+_\d+/tf/\w+)$"
)
_OF_THE_SYSTEM = re.compile(r"^/(rosout(_agg)?|parameter_events|diagnostics|clock|events/.*)$"
                            r"|^/(device_\d+|file_version)(?!.*/image/data)")  # fmt: skip
PNG_DEPTH = "16-bit PNG"


def base_name(topic: str) -> str:
    """Return the topic name without its image transport."""
    return topic.removesuffix("/compressedDepth").removesuffix("/compressed")


def is_picture(topic: Topic) -> bool:
    """Return whether a topic carries pictures."""
    return topic.kind in (IMAGE, COMPRESSED)


def choose_depth(
    path: Path, topics: Sequence[Topic], asked: str | None, encoding: Callable[[Topic], str]
) -> Topic:
    """Return the topic of depth; `encoding` tells that of a topic's first picture."""
    pictures = [topic for topic in topics if is_picture(topic)]
    # The plain `compressed` of a depth topic keeps what was measured as a PNG of 16 bits alone.
    able = [topic for topic in pictures
            if not topic.name.endswith("/compressed") or encoding(topic) == PNG_DEPTH]  # fmt: skip
    lossy = [topic for topic in pictures if topic not in able and (
        base_name(topic.name) == base_name(asked) if asked else _is_like(topic, *_DEPTH))
    ]  # fmt: skip
    hint = "" if not lossy else (
        f"; {lossy[0].name} is {encoding(lossy[0])!r}, which changes depth: record image_raw or "
        "compressedDepth"
    )  # fmt: skip
    return _choose(path, able, _DEPTH, asked, ("depth", "--depth-topic", topic_list(topics) + hint))


def choose_color(
    path: Path, topics: Sequence[Topic], depth: Topic, asked: str | None,
    encoding: Callable[[Topic], str],
) -> Topic | None:  # fmt: skip
    """Return the topic of color: by its usual name, else the only other one; None if none is."""
    able = [topic for topic in topics
            if is_picture(topic) and not topic.name.endswith("/compressedDepth")
            and base_name(topic.name) != base_name(depth.name)]  # fmt: skip
    usual = [topic for topic in able if _is_like(topic, *_COLOR)]
    if asked is None and not usual:
        no_color = (*GRAY_ENCODINGS, *DEPTH_ENCODINGS, PNG_DEPTH)
        others = [topic for topic in able
                  if not _GRAY.search(topic.name) and encoding(topic) not in no_color
                  and not _is_like(topic, *_DEPTH)]  # fmt: skip
        alone = len({base_name(topic.name) for topic in others}) == 1
        return min(others, key=_transport) if alone else None
    # The color of a camera shares the longest topic prefix with its depth.
    shared = max((_shared(topic.name, depth.name) for topic in usual), default=0)
    near = [topic for topic in able if _shared(topic.name, depth.name) >= shared]
    if asked and base_name(asked) == base_name(depth.name):
        raise InvalidRecordingError(
            f"{path}: --color-topic {asked!r} is the topic of depth; name the one of color, or "
            "give --without-color"
        )
    able = able if asked else near
    return _choose(path, able, _COLOR, asked, ("color", "--color-topic", topic_list(topics)))


def _is_like(topic: Topic, *patterns: str) -> bool:
    return any(re.search(pattern, base_name(topic.name)) for pattern in patterns)


def left_out(topics: Iterable[Topic], used: Sequence[str]) -> list[str]:
    """Return remarks on the topics that an import does not use."""
    known = {base_name(name) for name in used}
    rest = [topic for topic in topics
            if base_name(topic.name) not in known and not _OF_THE_SYSTEM.search(topic.name)
            and not topic.kind.endswith(("/CameraInfo", "/TFMessage", "/tfMessage"))]  # fmt: skip
    notes = []
    if pictures := [topic for topic in rest if is_picture(topic)]:
        notes.append(f"pictures that were left out: {topic_list(pictures, 8)}; --color-topic and "
                     "--depth-topic choose others")  # fmt: skip
    if others := [topic for topic in rest if not is_picture(topic)]:
        notes.append(f"topics that were not used: {topic_list(others, 8)}")
    return notes


def info_topic(topics: Iterable[Topic], image: Topic) -> Topic | None:
    """Return the topic with the intrinsics of a picture topic."""
    name = base_name(image.name)
    folder = name.rpartition("/")[0]
    wanted = [f"{place}/camera_info" for place in (
        folder, name, f"{folder.removesuffix('/image')}/info",
        folder.removesuffix("/hw_registered"))]  # fmt: skip
    known = {topic.name: topic for topic in topics if topic.kind == CAMERA_INFO}
    return next((known[name] for name in wanted if name in known), None)


def topic_list(topics: Iterable[Topic], limit: int = 30) -> str:
    """Return a list of the topics as text, pictures first."""
    ranked = sorted(set(topics), key=lambda topic: (not is_picture(topic), topic.name))
    words = [f"{topic.name} ({topic.kind.rpartition('/')[2]})" for topic in ranked[:limit]]
    more = [f"and {len(ranked) - limit} more"] if len(ranked) > limit else []
    return ", ".join(words + more) or "none"


def _choose(
    path: Path, able: Sequence[Topic], patterns: Sequence[str], asked: str | None,
    words: tuple[str, str, str],
) -> Topic:  # fmt: skip
    what, flag, every = words
    if asked is not None:
        kinds = [[topic for topic in able if topic.name == asked],
                 [topic for topic in able if base_name(topic.name) == asked]]  # fmt: skip
        problem = f"no {what} topic {asked!r}"
    else:
        kinds = [[topic for topic in able if _is_like(topic, pattern)] for pattern in patterns]
        problem = f"no topic has a usual name of {what}"
    candidates = next(filter(None, kinds), [])
    if not candidates:
        raise InvalidRecordingError(f"{path}: {problem}; topics: {every}; name one with {flag}")
    names = {base_name(topic.name) for topic in candidates}
    if len(names) > 1:
        raise InvalidRecordingError(
            f"{path}: {len(names)} topics may be the {what}: {', '.join(sorted(names))}; "
            f"choose one with {flag}"
        )
    return min(candidates, key=_transport)


def _transport(topic: Topic) -> tuple[bool, bool, str]:
    return topic.kind != IMAGE, not topic.name.endswith("/compressedDepth"), topic.name


def _shared(name: str, other: str) -> int:
    """Return how many leading parts two names have in common."""
    pairs = zip(name.split("/"), other.split("/"), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
