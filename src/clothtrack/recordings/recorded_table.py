"""The table in a recording, and the poses of the cameras in the world that it defines."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.table_plane import (
    LEAST_POINTS,
    PIXELS,
    TableFit,
    fit_plane,
    off_cloth,
    sight_lines,
)
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import ColorSegmenter, MaskFolder, Segmenter

FRAMES = 8
"""Number of frames used, spread over the recording."""


def fit_recorded_table(recording: Recording, camera: Camera) -> TableFit:
    """Return the table in a recording: the plane of most of the depth outside the cloth.

    The cloth is left out if masks or its color name identify it; the tool is too small to matter.

    Args:
        recording: a recording with depth from the camera.
        camera: the camera that looks at the table.

    Raises:
        InvalidRecordingError: there is no depth, nothing but cloth, or no plane that dominates.
    """
    frames = [frame for frame in recording.frames if camera.name in frame.depth]
    if not frames:
        raise InvalidRecordingError(
            f"{recording.folder}: camera {camera.name!r} has no depth to fit a table to; name "
            "another camera, or give a board"
        )
    chosen = np.unique(np.linspace(0, len(frames) - 1, FRAMES).round().astype(int))
    looks = [_look(recording, frames[place], camera) for place in chosen]
    measured = sum(int((depth > 0).sum()) for depth, _ in looks)
    kept = [off_cloth(depth, cloth) for depth, cloth in looks]
    excluded = any(cloth.any() for _, cloth in looks)
    left = sum(int((depth > 0).sum()) for depth in kept)
    if left < 0.05 * measured or left < LEAST_POINTS:
        raise InvalidRecordingError(
            f"{recording.folder}: camera {camera.name!r} sees hardly anything but the cloth "
            f"({left} of {measured} measurements); let it see the table, or give a board"
        )
    stride = max(1, left // PIXELS)
    sight, inverse = _concatenated(
        [sight_lines(depth, camera, stride=stride, offset=n) for n, depth in enumerate(kept)]
    )
    try:
        fit = fit_plane(sight, inverse)
    except InvalidRecordingError as error:
        raise InvalidRecordingError(
            f"{recording.folder}: camera {camera.name!r}: {error}; cloth.color or masks say it, "
            "and a board needs no plane"
        ) from error
    return TableFit(
        fit.normal,
        fit.distance_m,
        fit.residual_m,
        fit.inlier_share,
        excluded,
        len(chosen),
    )


def moved_along(
    recording: Recording, camera: Camera, world_from_camera: Float[np.ndarray, "4 4"]
) -> Mapping[str, Float[np.ndarray, "4 4"]]:
    """Return new poses of all cameras of a recording, given the new pose of one of them.

    The others keep their pose relative to it.
    """
    change = world_from_camera @ np.linalg.inv(camera.world_from_camera)
    poses = {}
    for other in recording.cameras:
        pose = change @ other.world_from_camera
        left, _, right = np.linalg.svd(pose[:3, :3])
        pose[:3, :3], pose[3] = left @ right, (0.0, 0.0, 0.0, 1.0)
        poses[other.name] = pose
    poses[camera.name] = world_from_camera
    return poses


def _look(
    recording: Recording, frame: Frame, camera: Camera
) -> tuple[Float[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
    """Return the depth [m] of a frame and its pixels of cloth; none if these are not known."""
    depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
    cloth = np.zeros(depth.shape, dtype=bool)
    find: Segmenter | None = None
    if camera.name in frame.mask:
        find = MaskFolder(frame.mask)
    elif recording.cloth.color is not None and camera.name in frame.color:
        find = ColorSegmenter.from_name(recording.cloth.color)
    if find is None:
        return depth, cloth
    color = read_color(frame.color[camera.name]) if camera.name in frame.color else None
    try:
        cloth = find(color, depth, camera, None)
    except InvalidRecordingError:
        # The background has the cloth's color: then nothing is left out.
        return depth, cloth
    return depth, cloth


def _concatenated(
    parts: Sequence[tuple[Float[np.ndarray, "_ 3"], Float[np.ndarray, " _"]]],
) -> tuple[Float[np.ndarray, "points 3"], Float[np.ndarray, " points"]]:
    return np.concatenate([one for one, _ in parts]), np.concatenate([one for _, one in parts])
