"""Decoding of ROS messages with the standard definitions, never with those in a file.

A definition in a file would be turned into code. The layout of the standard definitions is the same
in all distributions of ROS 2; ROS 1 has its own.
"""

import re
import struct
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack_capture.importing.containers import ZSTD_MAGIC, Container, Place, Topic, unpack
from clothtrack_capture.importing.intrinsics import Intrinsics

_TF = "tf2_msgs/msg/TFMessage"
# Headers of these messages start with a stamp.
_STAMPED = re.compile(r"^(sensor_msgs/msg/|geometry_msgs/msg/\w+Stamped$|nav_msgs/msg/Odometry$)")
_BROWN = {"", "plumb_bob", "rational_polynomial", "none", "brown conrady", "modified brown conrady"}
_FINGER = re.compile(r"finger|grip|jaw|knuckle|hand|claw", re.IGNORECASE)
_FISHEYE = {"equidistant", "fisheye", "kannala brandt4"}


@cache
def message_store(*, cdr: bool) -> Typestore:
    """Return the standard message types of ROS 2 (CDR), or of ROS 1."""
    if cdr:
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF))
    return store


def payload(container: Container, place: Place) -> bytes:
    """Return the bytes of a message, decompressed if messages are compressed individually."""
    data = container.fetch(place)
    return unpack(data, "zstd") if data.startswith(ZSTD_MAGIC) else data


def decode(topic: Topic, data: bytes) -> Any:
    """Return a message as an object with the fields of its definition."""
    kind = _TF if topic.kind == "tf/msg/tfMessage" else topic.kind
    store = message_store(cdr=topic.cdr)
    if kind not in store.types:
        raise TruncatedError(f"{topic.name}: {topic.kind} is no message type that is read here")
    try:
        return (store.deserialize_cdr if topic.cdr else store.deserialize_ros1)(data, kind)
    except Exception as error:  # The library refuses damaged bytes with eight kinds of exception.
        raise TruncatedError(f"{topic.name}: not a {topic.kind}") from error


def stamp_ns(container: Container, topic: Topic, place: Place) -> int:
    """Return the time in the header of a stamped message [ns]; 0 if it has none."""
    if not _STAMPED.match(topic.kind):
        return 0
    data = container.fetch(place, 16)
    packed = data.startswith(ZSTD_MAGIC)
    return header_stamp_ns(topic, payload(container, place) if packed else data)


def header_stamp_ns(topic: Topic, data: bytes) -> int:
    """Return the time in the header at the start of a message [ns]; 0 if there is none."""
    if len(data) < 12:
        raise TruncatedError(f"{topic.name}: a message without a header")
    order = "<" if not topic.cdr or data[1] & 1 else ">"
    seconds, nanoseconds = struct.unpack(order + "II", data[4:12])
    return 0 if nanoseconds >= 10**9 else seconds * 10**9 + nanoseconds


def position_of(topic: Topic, message: Any) -> tuple[str, tuple[float, float, float]] | None:
    """Return the frame ("" without one) and position [m] of a pose message; None if it is lost."""
    header, inner = getattr(message, "header", None), message
    for name in ("pose", "pose", "transform", "point", "position", "translation"):
        inner = getattr(inner, name, inner)
    if not hasattr(inner, "z"):
        raise TruncatedError(f"{topic.name}: {topic.kind} holds no position")
    frame = "" if header is None else str(header.frame_id).lstrip("/")
    position = float(inner.x), float(inner.y), float(inner.z)
    return (frame, position) if np.isfinite(position).all() else None


def gripper_joints(names: Sequence[str], asked: Sequence[str] = ()) -> list[str]:
    """Return a gripper's joints: those asked for, or by their names, or all of at most two."""
    if asked:
        return [name for name in names if name in asked]
    fingers = [name for name in names if _FINGER.search(name)]
    return fingers or list(names if len(names) <= 2 else ())


def grip_of(message: Any, joints: Sequence[str] = ()) -> bool | float | None:
    """Return whether a gripper is closed, or its opening, summed over joints; None without both."""
    names, value = list(getattr(message, "name", ())), message
    for name in ("position", "data"):
        value = getattr(value, name, value)
    if isinstance(value, bool | np.bool_):
        return bool(value)
    try:
        numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError):
        return None
    if names and len(names) == len(numbers):
        chosen = gripper_joints(names, joints)
        numbers = numbers[[name in chosen for name in names]]
    return float(np.sum(numbers)) if numbers.size else None


def _lens_of(info: Any) -> dict[str, np.ndarray]:
    """Return the matrix K, the distortion D and the projection P of a CameraInfo."""
    lens = {name: getattr(info, name, getattr(info, name.lower(), ())) for name in "KDP"}
    return {name: np.asarray(one, dtype=np.float64).ravel() for name, one in lens.items()}


def intrinsics_of(topic: str, info: Any, *, rectified: bool) -> Intrinsics:
    """Return the intrinsics in a CameraInfo."""
    lens, model = _lens_of(info), str(info.distortion_model).lower()
    rectified = rectified and lens["P"][0] > 0
    fx, cx, fy, cy = (lens["P"][[0, 2, 5, 6]] if rectified else lens["K"][[0, 2, 4, 5]]).tolist()
    straight = rectified or not np.abs(lens["D"]).max(initial=0.0) > 0
    coefficients = () if straight else tuple(lens["D"].tolist())
    fisheye = bool(coefficients) and model in _FISHEYE
    size, roi = (int(info.width), int(info.height)), info.roi
    if 0 < roi.width * roi.height < size[0] * size[1]:
        size = int(roi.width), int(roi.height)
        cx, cy = cx - roi.x_offset, cy - roi.y_offset
    try:
        if coefficients and model not in _BROWN | _FISHEYE:
            words = f"distortion model {info.distortion_model!r} with coefficients; known are "
            raise InvalidRecordingError(words + ", ".join(sorted(_BROWN | _FISHEYE - {""})))
        if not (fx > 0 and fy > 0):
            words = f"focal lengths ({fx:g}, {fy:g}), so the camera was not calibrated"
            raise InvalidRecordingError(words)
        return Intrinsics(*size, fx, fy, cx, cy, coefficients, fisheye)
    except InvalidRecordingError as error:
        raise InvalidRecordingError(f"{topic}: {error}; give --intrinsics FILE") from error


def lens_words(info: Any) -> str:
    """Return the numbers of a CameraInfo that place a pixel, as text."""
    words = [f"{name} {np.round(one, 3).tolist()}" for name, one in _lens_of(info).items()]
    return ", ".join([f"{int(info.width)} x {int(info.height)}", *words])
