"""The cameras that render simulated states, and the noise of their sensors."""

from dataclasses import asdict, dataclass
from typing import Any

from clothtrack.files.provenance import as_plain
from clothtrack.reconstruction.data.sensor_noise import SensorConfig

SENSORS = {
    "stereo": SensorConfig(),
    "structured_light": SensorConfig(
        white_m=0.0005, wave_m=0.001, disparity_step_m=0.0017, edge_dropout=0.8, edge_mixing=0.1
    ),
    "time_of_flight": SensorConfig(
        white_m=0.0015, wave_m=0.002, edge_dropout=0.1, edge_mixing=0.9, grazing_dropout=0.3
    ),
}
"""Average noise of each kind of sensor: active stereo like the RealSense D400; structured light
like Kinect v1 and Xtion, with steps of 3 mm at 1 m, wide shadows and no wave; time of flight like
Kinect v2 and Azure, with fine steps and edges that mix both depths."""

LEAST_DISTANCE_M, USUAL_DISTANCE_M = 0.45, 1.6
"""Least distance of a camera, and largest distance unless the cloth is too large for it [m]."""

MOST_TILT_DEG = 35.0
"""Largest angle between a tilted camera's axis and the vertical [deg]."""


@dataclass(frozen=True)
class RenderConfig:
    """Cameras that render a simulated state. Pairs of numbers are bounds of a uniform draw.

    Attributes:
        distance: distance from the camera to the middle of the cloth, over the cloth's extent.
        focal: focal length [pixels].
        offset: largest offset of the optical axis from the middle of the cloth, along x and along
            y, over the cloth's extent.
        tilt_deg: standard deviation of the optical axis from the vertical [deg].
        tilted: share of cameras that are tilted by any angle up to `MOST_TILT_DEG`.
        sensors: noise of the kinds of `SENSORS`, which are equally frequent.
        noise_range: bounds of the factor on the sensor's noise and drop-out.
        mask_jitter: probability that the mask is some pixels too large, and that it is too small.
        tool: share of pictures in which a tool or a hand hides part of the cloth.
        cut: share of pictures whose border cuts off part of the cloth.
    """

    distance: tuple[float, float] = (1.2, 2.8)
    focal: tuple[float, float] = (200.0, 450.0)
    offset: float = 0.3
    tilt_deg: float = 4.0
    tilted: float = 0.25
    sensors: tuple[SensorConfig, ...] = tuple(SENSORS.values())
    noise_range: tuple[float, float] = (0.0, 2.0)
    mask_jitter: float = 0.15
    tool: float = 0.15
    cut: float = 0.08

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for the metadata of weights, with each sensor under its name."""
        values = asdict(self)
        sensors = values.pop("sensors")
        return as_plain({**values, **dict(zip(SENSORS, sensors, strict=True))})
