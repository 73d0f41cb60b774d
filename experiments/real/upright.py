"""The world of a recording that has a camera and no table: upright, at the camera's place."""

import json
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.camera import Camera

WORLD_FROM_CAMERA: Float[np.ndarray, "4 4"] = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Camera frame (x right, y down, z forward) to a world with x right, y away and z up [m].

The camera is taken to stand level: the sources state no tilt.
"""


def level_camera(intrinsics: Path, name: str = "camera") -> Camera:
    """Return the camera of an `intrinsics.json`, standing level at the world's origin."""
    values = json.loads(intrinsics.read_text())
    pinhole = {key: values[key] for key in ("width", "height", "fx", "fy", "cx", "cy")}
    return Camera(name, **pinhole, world_from_camera=WORLD_FROM_CAMERA)


def upright(points: Float[np.ndarray, "*any 3"]) -> Float[np.ndarray, "*any 3"]:
    """Return points of the camera frame [m] in the upright world [m]."""
    return np.asarray(points, dtype=np.float64) @ WORLD_FROM_CAMERA[:3, :3].T
