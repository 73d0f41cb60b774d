"""Units and poses that the RealSense SDK writes with its pictures, in old and new files.

Old recordings (`.bag`) have typed messages, and new ones (`.db3`) have strings `key=value;...`.
Both name a stream's topics `/device_0/sensor_0/Depth_0/...`. `/tf_static` of the new ones uses
another convention (x forward) and is ignored.
"""

import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from clothtrack.errors import TruncatedError
from clothtrack_capture.importing.containers import Topic
from clothtrack_capture.importing.topics import base_name
from clothtrack_capture.importing.transforms import rigid

_STREAM = re.compile(r"^(/device_\d+/sensor_\d+)/[A-Za-z]+_\d+/image/data$")
WANTED = re.compile(r"^/device_\d+/sensor_\d+/(option/Depth[ _]Units/value|[A-Za-z]+_\d+/tf/\w+)$")


def is_stream(topic: Topic) -> bool:
    """Return whether the SDK wrote this picture topic."""
    return bool(_STREAM.match(base_name(topic.name)))


def depth_unit_m(heard: Mapping[str, Any], depth: Topic) -> float | None:
    """Return meters per unit of depth, from the sensor's option."""
    sensor = _STREAM.sub(r"\1", base_name(depth.name))
    for spelling in ("Depth Units", "Depth_Units"):
        with suppress(KeyError, ValueError):
            message = heard[f"{sensor}/option/{spelling}/value"]
            # The SDK stores a 32-bit float, so 0.001 is read as 0.0010000000474974513.
            return float(f"{float(message.data):.6g}")
    return None


def color_from_depth(
    heard: Mapping[str, Any], depth: Topic, color: Topic
) -> Float[np.ndarray, "4 4"] | None:
    """Return the rigid transform from depth to color camera [m]; None if the file has none."""
    poses: list[dict[str, np.ndarray]] = []
    for topic in (depth, color):
        head = f"{base_name(topic.name).removesuffix('/image/data')}/tf/"
        poses.append({name.removeprefix(head): _pose(message) for name, message in heard.items()
                      if name.startswith(head)})  # fmt: skip
    shared = min(poses[0].keys() & poses[1].keys(), default=None)
    return None if shared is None else poses[1][shared] @ np.linalg.inv(poses[0][shared])


def _pose(message: Any) -> Float[np.ndarray, "4 4"]:
    """Return the transform from the reference stream to this stream."""
    try:
        if hasattr(message, "rotation"):
            q, t = message.rotation, message.translation
            return rigid(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), [t.x, t.y, t.z])
        fields = dict(part.split("=", 1) for part in str(message.data).split(";") if "=" in part)
        rotation, translation = (np.array(fields[name].split(","), dtype=np.float64)
                                 for name in ("rotation", "translation"))  # fmt: skip
        return rigid(rotation.reshape(3, 3).T, translation)  # the SDK writes column by column
    except (AttributeError, KeyError, ValueError) as error:
        raise TruncatedError("a stream's pose that is none") from error
