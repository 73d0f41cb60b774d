"""Rendering of a simulated state by a random camera above it and a noisy sensor.

It renders one state with its labels, as `token_pictures.py` does for a whole batch.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Bool, Float

from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture
from clothtrack.reconstruction.data.render_config import (
    LEAST_DISTANCE_M,
    MOST_TILT_DEG,
    USUAL_DISTANCE_M,
    RenderConfig,
)
from clothtrack.reconstruction.data.sensor_noise import SensorConfig, depth_noise
from clothtrack.recordings.camera_view import flying_pixels

_MARGIN_PIXELS = 6
"""Free space around the cloth in a picture [pixels]."""


def render(
    positions: Float[np.ndarray, "vertices 3"],
    mesh: ClothMesh,
    config: RenderConfig,
    rng: np.random.Generator,
) -> LabeledPicture:
    """Return a picture of a cloth on the table z = 0, by a camera above it with a noisy sensor.

    Only the part of the camera's picture around the cloth is rendered.

    Args:
        positions: vertices in the world [m].
    """
    camera = _camera_above(positions, config, rng)
    drawn = Rasterizer(mesh.faces, camera).render(positions)
    on_cloth = drawn.faces >= 0
    depth, facing = _perfect_depth(drawn.depth, drawn.faces, positions, mesh, camera)
    measured = depth_noise(depth, facing, _wave(depth.shape, rng), _sensor(config, rng), rng)
    mask = _jittered(on_cloth, config.mask_jitter, rng)
    mask &= (measured > 0) & ~flying_pixels(measured, camera.fx)
    mask &= ~_hidden(positions, mask, camera, config, rng)
    return LabeledPicture(measured, mask, camera, drawn.faces, positions)


def _hidden(
    positions: Float[np.ndarray, "vertices 3"],
    mask: Bool[np.ndarray, "height width"],
    camera: Camera,
    config: RenderConfig,
    rng: np.random.Generator,
) -> Bool[np.ndarray, "height width"]:
    """Return what a tool or a hand hides, and what the picture's border cuts off."""
    hidden = np.zeros(mask.shape, np.uint8)
    extent = np.ptp(positions[:, :2], axis=0).max()
    in_the_air = positions[:, 2].max() > 0.3 * extent
    if rng.random() < (0.7 if in_the_air else config.tool):
        # Lifted cloth is held at its top; a hand comes from the border of the picture.
        held = positions[:, 2].argmax() if in_the_air else rng.integers(len(positions))
        (pixels, (depth, *_)) = camera.project(positions[held : held + 1])
        tip = np.round(pixels[0]).astype(int)
        radius = camera.fx / max(depth, 0.1) * extent * rng.uniform(0.02, 0.08)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        length = 0.0 if rng.random() < 0.5 else float(sum(mask.shape))
        end = tip + length * np.array([np.cos(angle), np.sin(angle)])
        cv2.line(hidden, tip.tolist(), end.astype(int).tolist(), 1, max(1, round(2.0 * radius)))
    if rng.random() < config.cut:
        rows, columns = np.nonzero(mask)
        angle = rng.choice(4) * np.pi / 2.0
        along = np.cos(angle) * columns + np.sin(angle) * rows
        if len(along):
            line = np.quantile(along, 1.0 - rng.uniform(0.0, 0.25))
            hidden[rows[along > line], columns[along > line]] = 1
    return hidden.astype(bool)


def _camera_above(
    positions: Float[np.ndarray, "vertices 3"], config: RenderConfig, rng: np.random.Generator
) -> Camera:
    """Return a camera that looks down on the cloth, with its picture cropped around the cloth."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    extent = float((high - low)[:2].max())
    tilt_rad = np.radians(config.tilt_deg) * rng.standard_normal(2)
    if rng.random() < config.tilted:
        heading = rng.uniform(0.0, 2.0 * np.pi)
        angle = np.radians(rng.uniform(0.0, MOST_TILT_DEG))
        tilt_rad = angle * np.array([np.cos(heading), np.sin(heading)])
    tilt, _ = cv2.Rodrigues(np.append(tilt_rad, 0.0))
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ tilt
    target = 0.5 * (low + high)
    target[:2] += extent * rng.uniform(-config.offset, config.offset, 2)
    # Keep clear of cloth that is lifted towards the camera, too.
    distance = min(extent * rng.uniform(*config.distance), max(USUAL_DISTANCE_M, 1.2 * extent))
    distance = max(LEAST_DISTANCE_M, distance)
    distance += 0.5 * float(high[2] - low[2])
    pose[:3, 3] = target - distance * pose[:3, 2]
    focal = rng.uniform(*config.focal)
    wide = Camera("top", 1, 1, focal, focal, 0.0, 0.0, pose)
    pixels, _ = wide.project(positions)
    # The principal point stays in the picture, as in an uncropped picture.
    first = np.floor(np.minimum(pixels.min(axis=0), 0.0)).astype(int) - _MARGIN_PIXELS
    last = np.ceil(np.maximum(pixels.max(axis=0), 0.0)).astype(int) + _MARGIN_PIXELS
    width, height = (last - first + 1).tolist()
    return Camera("top", width, height, focal, focal, float(-first[0]), float(-first[1]), pose)


def _perfect_depth(
    depth: Float[np.ndarray, "height width"],
    faces: np.ndarray,
    positions: Float[np.ndarray, "vertices 3"],
    mesh: ClothMesh,
    camera: Camera,
) -> tuple[Float[np.ndarray, "height width"], Float[np.ndarray, "height width"]]:
    """Return depth [m] of cloth and table, and the cosine between line of sight and normal."""
    across = ((np.arange(camera.width) - camera.cx) / camera.fx).astype(np.float32)
    down = ((np.arange(camera.height) - camera.cy) / camera.fy).astype(np.float32)[:, None]
    rotation = camera.world_from_camera[:3, :3].astype(np.float32)
    upwards = rotation[2, 0] * across + rotation[2, 1] * down + rotation[2, 2]
    table = np.float32(-camera.position[2]) / np.minimum(upwards, np.float32(-1e-3))
    facing = np.abs(upwards)
    a, b, c = np.moveaxis(positions[mesh.faces].astype(np.float32), 1, 0)
    normals = np.cross(b - a, c - a) @ rotation
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    rows, columns = np.nonzero(faces >= 0)
    shown = normals[faces[rows, columns]].T
    facing[rows, columns] = np.abs(shown[0] * across[columns] + shown[1] * down[rows, 0] + shown[2])
    facing /= np.sqrt(across**2 + down**2 + 1.0)
    return np.where(faces >= 0, depth, table), facing


def _wave(shape: tuple[int, ...], rng: np.random.Generator) -> Float[np.ndarray, "height width"]:
    """Return a smooth random field with a standard deviation of about one."""
    coarse = rng.standard_normal((5, 6), dtype=np.float32)
    return cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)


def _sensor(config: RenderConfig, rng: np.random.Generator) -> SensorConfig:
    """Return a sensor with randomly scaled noise."""
    scale = rng.uniform(*config.noise_range)
    mean = config.sensors[int(rng.integers(len(config.sensors)))]
    return replace(
        mean,
        white_m=scale * mean.white_m,
        wave_m=scale * mean.wave_m,
        dropout=min(1.0, scale * mean.dropout),
        grazing_dropout=min(1.0, scale * mean.grazing_dropout),
        edge_dropout=min(1.0, scale * mean.edge_dropout),
    )


def _jittered(
    mask: Bool[np.ndarray, "height width"], probability: float, rng: np.random.Generator
) -> Bool[np.ndarray, "height width"]:
    """Return the mask, sometimes up to 3 pixels too large or too small, as from segmentation."""
    drawn = rng.random()
    if drawn >= 2.0 * probability:
        return mask
    change = cv2.dilate if drawn < probability else cv2.erode
    size = 1 + 2 * int(rng.integers(1, 4))
    return change(mask.view(np.uint8), np.ones((size, size), np.uint8)).view(bool)
