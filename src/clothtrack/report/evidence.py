"""Observation of a frame, as a picture to draw on and as points.

A view shows the first of these that exists: the color picture, the depth picture in gray, the
point cloud projected on a plain background.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from clothtrack.errors import ClothTrackError
from clothtrack.evaluation.metrics import cloud_floor, root_mean_square_mm
from clothtrack.evaluation.results import observed_chamfer
from clothtrack.geometry.camera import Camera
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.point_cloud import Observation, observe
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.report.palette import OBSERVED, PAPER, rgb255
from clothtrack.tracking.tracked_trajectory import TrackedTrajectory

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class ObservedSteps:
    """Observations at every step of a trajectory, and their distance from its mesh.

    Attributes:
        clouds: observed points [m, world] of each step.
        rms_mm: root of half the two-way Chamfer distance [mm] of observable visible vertices and
            observed points (`clothtrack.evaluation.results`); NaN without an observation.
        floor_mm: the same between two halves of the cloud [mm], the value of a perfect mesh.
    """

    clouds: Sequence[Float[np.ndarray, "_ 3"]]
    rms_mm: Float[np.ndarray, " frames"]
    floor_mm: Float[np.ndarray, " frames"]


def observed(recording: Recording, frame: Frame) -> Observation | None:
    """Return the observation of the cloth; None, with a warning, if there is none.

    An unreadable frame must not fail the report of a finished run.
    """
    try:
        return observe(recording, frame)
    except ClothTrackError as error:
        log.warning("frame %d of %s: no point cloud (%s)", frame.index, recording.name, error)
        return None


def observed_points(recording: Recording, frame: Frame) -> Float[np.ndarray, "points 3"]:
    """Return the observed points of a frame [m, world]; empty if there are none."""
    observation = observed(recording, frame)
    return np.empty((0, 3)) if observation is None else observation.points


def evidence_of(tracked: TrackedTrajectory, recording: Recording) -> ObservedSteps:
    """Return the observed points of all steps; hold one full observation at a time."""
    clouds, rms_mm = [], np.full(len(tracked.frames), np.nan)
    floor_mm = rms_mm.copy()
    for step in range(len(tracked.frames)):
        observation = observed(recording, frame_of(tracked, recording, step))
        clouds.append(np.empty((0, 3)) if observation is None else observation.points)
        if observation is not None:
            rms_mm[step] = mesh_distance_mm(tracked, step, observation)
            floor_mm[step] = root_mean_square_mm(cloud_floor(observation.points))
    return ObservedSteps(clouds, rms_mm, floor_mm)


def frame_of(tracked: TrackedTrajectory, recording: Recording, step: int) -> Frame:
    """Return the recording's frame of a step; a frame without pictures if it is missing."""
    index, time_s = int(tracked.frames[step]), float(tracked.time_s[step])
    found = next((frame for frame in recording.frames if frame.index == index), None)
    return found or Frame(index, time_s)


def mesh_distance_mm(tracked: TrackedTrajectory, step: int, observation: Observation) -> float:
    """Return the distance [mm] of visible mesh and observed points (`ObservedSteps.rms_mm`)."""
    vertices = tracked.positions[step].astype(np.float64)
    return root_mean_square_mm(observed_chamfer(vertices, tracked.visible[step], observation))


def thinned(
    points: Float[np.ndarray, "points 3"], count: int, *, seed: int = 0
) -> Float[np.ndarray, "kept 3"]:
    """Return at most `count` of the points, chosen uniformly at random."""
    if len(points) <= count:
        return points
    chosen = np.random.default_rng(seed).choice(len(points), count, replace=False)
    return points[np.sort(chosen)]


def has_picture(frame: Frame, camera: Camera) -> bool:
    """Return whether the frame has a color or a depth picture from this camera."""
    return camera.name in frame.color or camera.name in frame.depth


def view_picture(
    recording: Recording,
    frame: Frame,
    camera: Camera,
    points: Float[np.ndarray, "points 3"],
) -> UInt8[np.ndarray, "height width 3"]:
    """Return the RGB picture of a frame in the size of `camera`, a resized or virtual one.

    `points` [m, world] are drawn if the frame has no picture of that camera's name.
    """
    try:
        if camera.name in frame.color:
            return _resized(read_color(frame.color[camera.name]), camera)
        if camera.name in frame.depth:
            unit = recording.depth_units_m[camera.name]
            return _resized(_gray_depth(read_depth(frame.depth[camera.name], unit)), camera)
    except ClothTrackError as error:
        log.warning("frame %d of %s: no picture (%s)", frame.index, recording.name, error)
    return cloud_picture(points, camera)


def cloud_picture(
    points: Float[np.ndarray, "points 3"], camera: Camera
) -> UInt8[np.ndarray, "height width 3"]:
    """Return points [m, world] drawn on a plain background."""
    image = np.full((camera.height, camera.width, 3), rgb255(PAPER), dtype=np.uint8)
    pixels, depth = camera.project(np.asarray(points, dtype=np.float64))
    pixels = np.rint(pixels[depth > 1e-3]).astype(np.int64)
    for shift in ((0, 0), (1, 0), (0, 1), (1, 1)):
        columns, rows = (pixels + shift).T
        inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
        image[rows[inside], columns[inside]] = rgb255(OBSERVED)
    return image


def _resized(
    image: UInt8[np.ndarray, "height width 3"], camera: Camera
) -> UInt8[np.ndarray, "rows columns 3"]:
    if image.shape[:2] == (camera.height, camera.width):
        return image
    shrinking = camera.width < image.shape[1]
    how = cv2.INTER_AREA if shrinking else cv2.INTER_LINEAR
    return cv2.resize(image, (camera.width, camera.height), interpolation=how)


def _gray_depth(depth: Float[np.ndarray, "height width"]) -> UInt8[np.ndarray, "height width 3"]:
    """Return depth in gray: near is light, far is dark, unmeasured is black."""
    measured = depth > 0
    if not measured.any():
        return np.zeros((*depth.shape, 3), dtype=np.uint8)
    near, far = np.percentile(depth[measured], (1, 99))
    nearness = 1.0 - np.clip((depth - near) / max(far - near, 1e-3), 0.0, 1.0)
    gray = np.where(measured, 60 + 170 * nearness, 0).astype(np.uint8)
    return np.repeat(gray[..., None], 3, axis=2)
