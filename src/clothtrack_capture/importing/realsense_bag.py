"""Units and poses that the RealSense SDK writes with its pictures, in old and new files.

Old recordings (`.bag`) have typed messages, and new ones (`.db3`) have strings `key=value;...`.
Both name a stream's topics `/device_0/sensor_0/Depth_0/...`. `/tf_static` of the new ones uses
another convention (x forward) and is ignored.
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from clothtrack.errors import TruncatedError
from clothtrack.geometry.camera import rigid_problem
from clothtrack_capture.importing.containers import Topic
from clothtrack_capture.importing.messages import rigid_of
from clothtrack_capture.importing.topics import base_name

_STREAM = re.compile(r"^(/device_\d+/sensor_\d+)/[A-Za-z]+_\d+/image/data$")
WANTED = re.compile(r"^/device_\d+/sensor_\d+/(option/Depth[ _]Units/value|[A-Za-z]+_\d+/tf/\w+)$")


def is_stream(topic: Topic) -> bool:
    """Return whether the SDK wrote this picture topic."""
    return bool(_STREAM.match(base_name(topic.name)))


def depth_unit_m(heard: Mapping[str, Any], depth: Topic) -> float | None:
    """Return meters per unit of depth, from the sensor's option."""
    match = _STREAM.match(base_name(depth.name))
    if match is None:
        return None
    for spelling in ("Depth Units", "Depth_Units"):
        message = heard.get(f"{match[1]}/option/{spelling}/value")
        if message is not None:
            try:
                # The SDK stores a 32-bit float, so 0.001 is read as 0.0010000000474974513.
                return float(f"{float(message.data):.6g}")
            except ValueError:
                return None
    return None


def color_from_depth(
    heard: Mapping[str, Any], depth: Topic, color: Topic
) -> Float[np.ndarray, "4 4"] | None:
    """Return the rigid transform from depth to color camera [m]; None if the file has none."""
    poses = []
    for topic in (depth, color):
        stream = base_name(topic.name).removesuffix("/image/data")
        text = {
            name.rpartition("/")[2]: message
            for name, message in heard.items()
            if name.startswith(f"{stream}/tf/")
        }
        poses.append({reference: _pose(message) for reference, message in text.items()})
    shared = sorted(poses[0].keys() & poses[1].keys())
    if not shared:
        return None
    return poses[1][shared[0]] @ np.linalg.inv(poses[0][shared[0]])


def _pose(message: Any) -> Float[np.ndarray, "4 4"]:
    """Return the transform from the reference stream to this stream."""
    if hasattr(message, "rotation"):
        return rigid_of(message)
    fields = dict(part.split("=", 1) for part in str(message.data).split(";") if "=" in part)
    try:
        rotation = np.array(fields["rotation"].split(","), dtype=np.float64)
        translation = np.array(fields["translation"].split(","), dtype=np.float64)
        result = np.eye(4)
        result[:3, :3] = rotation.reshape(3, 3).T  # the SDK writes column by column
        result[:3, 3] = translation
    except (KeyError, ValueError) as error:
        raise TruncatedError("a stream's pose that is none") from error
    if problem := rigid_problem(result):
        raise TruncatedError(f"a stream's pose {problem}")
    return result
