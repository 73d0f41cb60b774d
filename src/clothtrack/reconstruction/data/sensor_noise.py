"""The noise model of a depth camera: noise, silhouettes, grazing surfaces, holes."""

from dataclasses import dataclass
from typing import Annotated, Any

import cv2
import numpy as np
from jaxtyping import Float

from clothtrack.files.bounds import Bounds, Checked, Share

REFERENCE_DEPTH_M = 0.75

Pixels = Annotated[int, Bounds(least=8, most=10_000)]
Noise = Annotated[float, Bounds(least=0, most=1)]


@dataclass(frozen=True)
class SensorConfig(Checked):
    """A depth camera above a table, with its noise parameters.

    The defaults are those of an active stereo camera like the RealSense D400: noise grows with
    the square of the depth, silhouettes are uncertain, grazing surfaces drop out.

    Attributes:
        width: image width [pixels].
        height: image height [pixels].
        focal: focal length [pixels] at this width.
        camera_height_m: height above the table [m].
        tilt_deg: standard deviation of the optical axis from the vertical [deg].
        white_m: standard deviation of independent noise [m] at 0.75 m.
        wave_m: standard deviation of slowly varying error [m], constant throughout a recording.
        step_m: quantization of depth [m]; also the unit of the depth files.
        disparity_step_m: further quantization of depth at 0.75 m [m], which grows with the square
            of the depth, as in a camera that measures whole steps of disparity; 0: none.
        dropout: share of pixels without a measurement on a surface seen from the front.
        grazing_dropout: additional share on a surface seen edge-on.
        edge_step_m: jump of depth [m] between neighbors that counts as a silhouette.
        edge_dropout: share of silhouette pixels without a measurement.
        edge_mixing: share of the other silhouette pixels that mix both depths.
        patch_dropout: share of the picture without a measurement in connected patches that drift
            from picture to picture, as if the pattern of an active camera were washed out.
        patch_pixels: usual width of such a patch [pixels].
    """

    width: Pixels = 640
    height: Pixels = 480
    focal: Annotated[float, Bounds(least=1, most=100_000)] = 600.0
    camera_height_m: Annotated[float, Bounds(least=0.01, most=100)] = 0.75
    tilt_deg: Annotated[float, Bounds(least=0, most=45)] = 2.0
    white_m: Noise = 0.001
    wave_m: Noise = 0.0005
    step_m: Annotated[float, Bounds(least=1e-7, most=0.1)] = 0.0005
    disparity_step_m: Noise = 0.0
    dropout: Share = 0.02
    grazing_dropout: Share = 0.6
    edge_step_m: Noise = 0.01
    edge_dropout: Share = 0.4
    edge_mixing: Share = 0.5
    patch_dropout: Share = 0.0
    patch_pixels: Annotated[float, Bounds(least=1, most=10_000)] = 24.0

    @classmethod
    def perfect(cls, **changes: Any) -> "SensorConfig":
        """Return a camera that measures exactly, except for `changes`."""
        exact: dict[str, Any] = dict.fromkeys(
            ("white_m", "wave_m", "dropout", "grazing_dropout", "edge_dropout", "edge_mixing"), 0.0
        )
        return cls(**{**exact, "step_m": 1e-6, **changes})


def depth_noise(
    depth: Float[np.ndarray, "height width"],
    facing: Float[np.ndarray, "height width"],
    wave: Float[np.ndarray, "height width"],
    config: SensorConfig,
    rng: np.random.Generator,
) -> Float[np.ndarray, "height width"]:
    """Return the measured depth [m] for a perfect depth picture; 0 = no measurement.

    Args:
        depth: true depth [m], positive everywhere.
    """

    def uniform() -> Float[np.ndarray, "height width"]:
        return rng.random(depth.shape, dtype=np.float32)

    kernel = np.ones((3, 3), np.uint8)
    near, far = cv2.erode(depth, kernel), cv2.dilate(depth, kernel)
    edge = far - near > config.edge_step_m
    mixed = edge & (uniform() < config.edge_mixing)
    measured = np.where(mixed, near + uniform() * (far - near), depth)
    error = config.white_m * rng.standard_normal(depth.shape, dtype=np.float32)
    error += config.wave_m * wave
    measured = measured + (depth / REFERENCE_DEPTH_M) ** 2 * error
    grazing = np.clip((0.4 - facing) / 0.4, 0.0, 1.0)
    lost = uniform() < config.dropout + config.grazing_dropout * grazing
    lost |= edge & (uniform() < config.edge_dropout)
    if config.disparity_step_m > 0.0:
        disparity = 1.0 / np.maximum(measured, 1e-3)
        step = np.float32(config.disparity_step_m / REFERENCE_DEPTH_M**2)
        measured = 1.0 / np.maximum(np.round(disparity / step) * step, step)
    quantized = np.round(measured / config.step_m) * config.step_m
    return np.where(lost, 0.0, np.maximum(quantized, 0.0))
