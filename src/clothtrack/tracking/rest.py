"""Detect cloth at rest, so that its mesh stays as it is. Not in the paper.

A simulated fold may keep settling after the real one has come to rest, for example because the real
cloth holds a stiff loop that collapses in simulation.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import read_depth
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.simulation.picker_action import PickerAction
from clothtrack.tracking.protocols import Observe

_WINDOW = 5
"""Width of the windows in which depth changes are averaged [pixels]; it leaves 1/5 of the noise."""

_NOISE_FACTOR = 6.0
"""A pixel has changed if its averaged change exceeds this many times the median of the picture,
most of which is table that never moves. This is four standard deviations of Gaussian noise."""

_SMALLEST_CHANGE_M = 0.0015
"""Smallest averaged change of depth [m] that counts."""

_CHANGED_SHARE = 0.005
"""Share of the cloth's pixels that may have changed in a cloth at rest. In the benchmark's
recordings it is below 0.001 before the first grasp and above 0.01 while cloth settles."""

REACH = 2
"""A pixel shows cloth if a cloud point is this near [pixels]; clouds are thinned to 4 mm."""


@dataclass(frozen=True)
class PicturesAtRest:
    """Rest test that compares the depth pictures of two frames while no picker holds the cloth.

    Attributes:
        recording: the recording; without depth pictures, no frame is at rest.
    """

    recording: Recording
    observe: Observe

    def __call__(self, action: PickerAction, tracked_at: Frame, frame: Frame) -> bool:
        """Return whether the cloth has not moved since it was last tracked."""
        if action.motion is not None:
            return False
        cameras = [
            camera
            for camera in self.recording.cameras
            if camera.name in tracked_at.depth and camera.name in frame.depth
        ]
        return bool(cameras) and not any(
            self._changed(camera, tracked_at, frame) for camera in cameras
        )

    def _changed(self, camera: Camera, before: Frame, after: Frame) -> bool:
        """Return whether the depth of cloth that is seen in both frames has changed."""
        unit_m = self.recording.depth_units_m[camera.name]
        depths = [read_depth(frame.depth[camera.name], unit_m) for frame in (before, after)]
        cloth = [shown(self.observe(frame).points, camera) for frame in (before, after)]
        change_m = averaged_change(*depths)
        known = np.isfinite(change_m)
        judged = known & cloth[0] & cloth[1]
        if not judged.any():
            return True
        limit_m = max(_SMALLEST_CHANGE_M, _NOISE_FACTOR * float(np.median(change_m[known])))
        return float((change_m[judged] > limit_m).mean()) > _CHANGED_SHARE


def averaged_change(
    before_m: Float[np.ndarray, "height width"], after_m: Float[np.ndarray, "height width"]
) -> Float[np.ndarray, "height width"]:
    """Return the absolute value of the window-averaged depth change [m]; NaN if mostly unknown."""
    both = (before_m > 0) & (after_m > 0)
    change = np.where(both, after_m - before_m, 0.0).astype(np.float32)
    share = cv2.boxFilter(both.astype(np.float32), -1, (_WINDOW, _WINDOW))
    mean = cv2.boxFilter(change, -1, (_WINDOW, _WINDOW))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(share > 0.5, np.abs(mean / share), np.nan).astype(np.float64)


def shown(
    points: Float[np.ndarray, "points 3"], camera: Camera
) -> Bool[np.ndarray, "height width"]:
    """Return the pixels that show the points of a cloud."""
    image = np.zeros((camera.height, camera.width), np.uint8)
    pixels, depth = camera.project(points)
    columns, rows = np.rint(pixels[depth > 0]).astype(np.int64).T
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    image[rows[inside], columns[inside]] = 1
    return cv2.dilate(image, np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8)).view(bool)


def never_at_rest(
    action: PickerAction,  # noqa: ARG001
    tracked_at: Frame,  # noqa: ARG001
    frame: Frame,  # noqa: ARG001
) -> bool:
    """Return False: every frame is tracked, as in the paper."""
    return False
