"""Measurements of a picture without a mesh: visible cloth, and the table area that it hides."""

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.planning.action_space import SeenCloth
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Frame, Recording, Table
from clothtrack.recordings.segmentation import default_segmenter, main_components


def seen_cloth(recording: Recording, observation: Observation) -> SeenCloth:
    """Return the input of action selection: cloud, first camera and table height."""
    height = 0.0 if recording.table is None else float(recording.table.point[2])
    camera = observation.cameras[0] if observation.cameras else None
    return SeenCloth(observation.points, camera, height)


def seen_area(recording: Recording, frame: Frame) -> float:
    """Return the area of the table [m^2] that the cloth hides from the first camera with depth.

    The area is the sum over cloth pixels of their area on the table. Cloth above the table hides
    a little more than it covers.
    """
    if recording.table is None:
        raise InvalidRecordingError(
            f"{recording.folder}: it has no table; coverage is measured on one"
        )
    camera = next((camera for camera in recording.cameras if camera.name in frame.depth), None)
    if camera is None:
        raise InvalidRecordingError(
            f"{recording.folder}: frame {frame.index} has no depth picture; record one"
        )
    depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
    color = read_color(frame.color[camera.name]) if camera.name in frame.color else None
    find = default_segmenter(recording, frame, camera)
    cloth = main_components(find(color, depth, camera, recording.table))
    return float(table_pixel_areas(camera, recording.table)[cloth].sum())


def table_pixel_areas(camera: Camera, table: Table) -> Float[np.ndarray, "height width"]:
    """Return the area of the table [m^2] per pixel: z^2 / (fx fy n.r), ray r = (x, y, 1)."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack(
        [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(rows.shape)],
        axis=-1,
    )
    normal = camera.world_from_camera[:3, :3].T @ table.normal
    slope = rays @ normal
    with np.errstate(divide="ignore"):
        depth = ((table.point - camera.position) @ table.normal) / slope
        areas = depth**2 / (camera.fx * camera.fy * np.abs(slope))
    return np.where(depth > 0.0, areas, 0.0)
