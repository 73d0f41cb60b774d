"""Drawing of an action on a picture, as an arrow from pick to place."""

import cv2
import numpy as np
from jaxtyping import UInt8

from clothtrack.geometry.camera import Camera
from clothtrack.planning.action_space import PickPlace

_ARROW = (217, 70, 50)
OUTLINE = (255, 255, 255)


def draw_action(
    image: UInt8[np.ndarray, "height width 3"], camera: Camera, action: PickPlace
) -> UInt8[np.ndarray, "height width 3"]:
    """Return a copy of the camera's RGB picture with an arrow from pick to place."""
    drawn = np.ascontiguousarray(image.copy())
    pixels, _ = camera.project(np.stack([action.pick, action.place]))
    start, end = (tuple(round(float(value)) for value in pixel) for pixel in pixels)
    wide = max(1, camera.width // 220)
    for color, width in ((OUTLINE, 2 * wide + 2), (_ARROW, wide + 1)):
        cv2.arrowedLine(drawn, start, end, color, width, cv2.LINE_AA, tipLength=0.18)
        cv2.circle(drawn, start, 3 * wide, color, -1 if color == _ARROW else width, cv2.LINE_AA)
    return drawn


def shown_depth(depth_m: np.ndarray) -> UInt8[np.ndarray, "height width 3"]:
    """Return a depth picture [m] in gray, near is bright, for cameras without color."""
    measured = depth_m[depth_m > 0]
    if not len(measured):
        return np.zeros((*depth_m.shape, 3), np.uint8)
    low, high = np.percentile(measured, (1, 99))
    gray = 255.0 * np.clip((high - depth_m) / max(high - low, 1e-6), 0.0, 1.0)
    gray[depth_m <= 0] = 0.0
    return np.repeat(gray.astype(np.uint8)[..., None], 3, axis=2)
