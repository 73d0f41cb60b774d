"""The simulated depth camera, with measurement errors."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from clothtrack.geometry.camera import Camera
from clothtrack.reconstruction.data.sensor_noise import SensorConfig, depth_noise
from clothtrack_lab.world.appearance import Appearance, Painter
from clothtrack_lab.world.scene import CLOTH, Scene

_PATCH_PERIOD_FRAMES = 80.0
"""Period of the patches without depth [pictures]; they have moved after a quarter of it."""


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture of the camera.

    Attributes:
        depth: distance along the optical axis [m]; 0 where nothing was measured.
        hidden_share: share of the cloth's pixels that the tool hides.
        missing_share: share of the other cloth pixels that have no depth.
    """

    color: UInt8[np.ndarray, "height width 3"]
    depth: Float[np.ndarray, "height width"]
    hidden_share: float
    missing_share: float


def top_down_camera(config: SensorConfig, rng: np.random.Generator) -> Camera:
    """Return a camera above the origin of the table z = 0 that looks down with a random tilt.

    In its image the world's x points right and y points up.
    """
    tilt = np.radians(config.tilt_deg) * rng.standard_normal(2)
    roll = np.radians(config.tilt_deg) * rng.standard_normal()
    turn, _ = cv2.Rodrigues(np.array([tilt[0], tilt[1], roll]))
    downwards = np.diag([1.0, -1.0, -1.0])
    pose = np.eye(4)
    pose[:3, :3] = downwards @ turn
    # Its axis meets the table near the origin, so that the tilt moves nothing out of the picture.
    axis = pose[:3, 2]
    pose[:3, 3] = axis * (config.camera_height_m / axis[2])
    return Camera(
        "top",
        config.width,
        config.height,
        config.focal,
        config.focal,
        (config.width - 1) / 2.0,
        (config.height - 1) / 2.0,
        pose,
    )


def misplaced(camera: Camera, error_m: float, rng: np.random.Generator) -> Camera:
    """Return the camera moved by this length [m] in a random direction, as a calibration error."""
    direction = rng.standard_normal(3)
    pose = camera.world_from_camera.copy()
    pose[:3, 3] += error_m * direction / np.linalg.norm(direction)
    return replace(camera, world_from_camera=pose)


class Sensor:
    """A camera above one scene with a slowly varying error."""

    def __init__(
        self, scene: Scene, config: SensorConfig, appearance: Appearance, *, seed: int
    ) -> None:
        """Set up the sensor for a scene."""
        self._scene = scene
        self._config = config
        self._painter = Painter(appearance, scene.table_points)
        self._rng = np.random.default_rng(seed)
        self._wave = _wave(scene.camera, self._rng)
        self._patches = None if config.patch_dropout == 0.0 else _Patches(config, self._rng)

    def capture(
        self, vertices: Float[np.ndarray, "vertices 3"], tip: Float[np.ndarray, " 3"] | None
    ) -> Picture:
        """Take a picture for these cloth vertices and this tool tip [m]; None for no tool."""
        view = self._scene.view(vertices, tip)
        depth = depth_noise(view.depth, view.facing, self._wave, self._config, self._rng)
        if self._patches is not None:
            depth[self._patches.next()] = 0.0
        on_cloth = depth[view.label == CLOTH]
        missing = float((on_cloth == 0.0).mean()) if len(on_cloth) else 0.0
        return Picture(self._painter.paint(view), depth, view.hidden_share, missing)

    def save(self) -> dict[str, Any]:
        """Return the state of its noise as plain values; it determines the next picture."""
        patches = 0 if self._patches is None else self._patches.count
        return {"noise": self._rng.bit_generator.state, "patches": patches}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Restore the noise from `save` of a sensor with the same seed."""
        self._rng.bit_generator.state = saved["noise"]
        if self._patches is not None:
            self._patches.count = int(saved["patches"])


class _Patches:
    """The pixels without depth in each picture, at the peaks of a slowly changing random field."""

    def __init__(self, config: SensorConfig, rng: np.random.Generator) -> None:
        self._share, self.count = config.patch_dropout, 0
        size = config.width, config.height
        cells = [max(2, round(2.0 * length / config.patch_pixels)) for length in size[::-1]]
        self._fields = [
            cv2.resize(rng.standard_normal(cells), size, interpolation=cv2.INTER_CUBIC)
            for _ in range(2)
        ]

    def next(self) -> Bool[np.ndarray, "height width"]:
        """Return the pixels without depth in the next picture."""
        phase = 2.0 * np.pi * self.count / _PATCH_PERIOD_FRAMES
        self.count += 1
        field = np.cos(phase) * self._fields[0] + np.sin(phase) * self._fields[1]
        return field > np.quantile(field, 1.0 - self._share)


def _wave(camera: Camera, rng: np.random.Generator) -> Float[np.ndarray, "height width"]:
    """Return a smooth random field over the image, mean 0 and standard deviation 1."""
    coarse = rng.standard_normal((5, 6))
    field = cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_CUBIC)
    return (field - field.mean()) / field.std()
