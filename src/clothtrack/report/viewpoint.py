"""Virtual cameras that see the whole cloth."""

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.camera import Camera
from clothtrack.recordings.recording import Recording


def look_at(
    eye: Float[np.ndarray, " 3"],
    target: Float[np.ndarray, " 3"],
    *,
    width: int = 640,
    height: int = 480,
    field_of_view_deg: float = 40.0,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    name: str = "view",
) -> Camera:
    """Return a camera at `eye` [m] that looks at `target` [m], with `up` upwards in the image.

    `field_of_view_deg` is the vertical one. If the optical axis is parallel to `up`, the image's
    upward direction is the world's y (or x) axis.
    """
    forward = np.asarray(target, dtype=np.float64) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:
        other = (0.0, 1.0, 0.0) if abs(forward[1]) < 0.9 else (1.0, 0.0, 0.0)
        right = np.cross(forward, other)
    right /= np.linalg.norm(right)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    world_from_camera[:3, 3] = eye
    focal = 0.5 * height / np.tan(np.radians(field_of_view_deg) / 2)
    center = ((width - 1) / 2, (height - 1) / 2)
    return Camera(name, width, height, focal, focal, *center, world_from_camera)


def three_quarter_view(
    points: Float[np.ndarray, "points 3"],
    *,
    width: int = 640,
    height: int = 480,
    azimuth_deg: float = -60.0,
    elevation_deg: float = 38.0,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> Camera:
    """Return a view from the side and above that shows all `points` [m] with a small margin.

    The azimuth is counted around `up` from the axis nearest to the world's x.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    target = (low + high) / 2
    upward = np.asarray(up, dtype=np.float64) / np.linalg.norm(up)
    first = np.eye(3)[0 if abs(upward[0]) < 0.9 else 1]
    first -= (first @ upward) * upward
    first /= np.linalg.norm(first)
    second = np.cross(upward, first)
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    sideways = np.cos(azimuth) * first + np.sin(azimuth) * second
    direction = np.cos(elevation) * sideways + np.sin(elevation) * upward
    distance = max(0.05, float(np.linalg.norm(high - low)))
    for _ in range(6):  # fixed point: the points' box in the image is centered and just fits
        eye = target + distance * direction
        camera = look_at(eye, target, width=width, height=height, up=tuple(upward))
        pixels, depth = camera.project(points)
        if (depth <= 0.1 * distance).any():
            distance *= 2
            continue
        box = np.stack([pixels.min(axis=0), pixels.max(axis=0)])
        shift = (box.mean(axis=0) - (camera.cx, camera.cy)) * distance / camera.fx
        target = target + camera.world_from_camera[:3, :2] @ shift
        distance *= max(0.1, float(((box[1] - box[0]) / (0.86 * width, 0.86 * height)).max()))
    eye = target + distance * direction
    return look_at(eye, target, width=width, height=height, up=tuple(upward))


def upright(camera: Camera) -> tuple[float, float, float]:
    """Return the upward direction of a camera's image [world], used if there is no table."""
    x, y, z = -camera.world_from_camera[:3, 1]
    return float(x), float(y), float(z)


def view_of(
    points: Float[np.ndarray, "points 3"], recording: Recording, *, width: int, height: int
) -> Camera:
    """Return a 3/4 view that contains `points` [m, world], upright as the recording's scene."""
    up, azimuth, elevation = (0.0, 0.0, 1.0), -60.0, 38.0
    if recording.table is not None:
        x, y, z = recording.table.normal
        up = (float(x), float(y), float(z))
    else:
        elevation = 18.0
        if recording.cameras:
            up = upright(recording.cameras[0])
            azimuth = _azimuth_of(recording.cameras[0], points.mean(axis=0), up) + 28.0
    return three_quarter_view(
        points, width=width, height=height, up=up, azimuth_deg=azimuth, elevation_deg=elevation
    )


def _azimuth_of(
    camera: Camera, center: Float[np.ndarray, " 3"], up: tuple[float, float, float]
) -> float:
    """Return the azimuth of a camera around a point [degrees], as in `three_quarter_view`."""
    upward = np.asarray(up) / np.linalg.norm(up)
    first = np.eye(3)[0 if abs(upward[0]) < 0.9 else 1]
    first = first - (first @ upward) * upward
    towards = camera.position - center
    second = np.cross(upward, first / np.linalg.norm(first))
    return float(np.degrees(np.arctan2(towards @ second, towards @ first)))


def upward(recording: Recording, view: Camera) -> Float[np.ndarray, " 3"]:
    """Return the upward unit vector: the table's normal, or upwards in the image of `view`."""
    if recording.table is not None:
        return np.asarray(recording.table.normal, np.float64)
    return np.asarray(upright(view), np.float64)


def layers_axis(recording: Recording, view: Camera) -> Float[np.ndarray, " 3"]:
    """Return the stacking direction of layers: the table's normal, or towards the camera.

    Without a table and without a camera, it points towards the eye of `view`.
    """
    if recording.table is not None:
        return np.asarray(recording.table.normal, np.float64)
    camera = recording.cameras[0] if recording.cameras else view
    return -np.asarray(camera.world_from_camera[:3, 2], np.float64)
