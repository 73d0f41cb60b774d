"""The cameras that simulated states are seen by, and how badly their sensors measure."""

from dataclasses import asdict, dataclass
from typing import Any

from clothtrack.files.run_manifest import as_plain
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
"""How badly each kind of sensor measures, on average: active stereo as the RealSense D400;
structured light as Kinect v1 and Xtion, with steps of 3 mm at 1 m, wide shadows and no wave; time
of flight as Kinect v2 and Azure, with fine steps and edges that mix both depths."""

LEAST_DISTANCE_M, USUAL_DISTANCE_M = 0.45, 1.6
"""No camera is nearer than the one, nor farther than the other unless the cloth is too large for
it [m]."""

MOST_TILT_DEG = 35.0
"""A camera that looks from aside is this far from the vertical at most [deg]."""


@dataclass(frozen=True)
class RenderConfig:
    """The cameras that a simulated state is seen by. Pairs of numbers are bounds of an even draw.

    Attributes:
        distance: from the camera to the middle of the cloth, over the cloth's extent.
        focal: focal length [pixels].
        offset: the optical axis passes the middle of the cloth by up to this, over its extent.
        tilt_deg: standard deviation of the optical axis from the vertical [deg].
        tilted: share of cameras that look from aside, by any angle up to `MOST_TILT_DEG`.
        sensors: how badly the kinds of `SENSORS` measure; they come equally often.
        noise_range: the sensor's noise and drop-out are multiplied by a number between these.
        mask_jitter: probability that the mask is some pixels too large, and that it is too small.
        tool: share of pictures in which a tool or a hand hides part of the cloth.
        cut: share of pictures whose border cuts part of the cloth off.
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
        """Return plain values for the metadata of weights; each kind of sensor has its name."""
        values = asdict(self)
        sensors = values.pop("sensors")
        return as_plain({**values, **dict(zip(SENSORS, sensors, strict=True))})
