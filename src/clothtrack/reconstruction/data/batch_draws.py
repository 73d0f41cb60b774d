"""Random draws for the pictures of a batch, except for the noise of single pixels.

The draws are made on the CPU for any device, a few dozen numbers per picture, so that a seed gives
the same cameras and hands on a CPU and on a GPU.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Generator, Tensor

from clothtrack.reconstruction.data.render_config import (
    LEAST_DISTANCE_M,
    MOST_TILT_DEG,
    USUAL_DISTANCE_M,
    RenderConfig,
)

_HELD_HEIGHT = 0.3
"""Height, over the cloth's extent, above which cloth is lifted and something holds its top."""

HELD = 0.7
"""Probability that the tool or hand that holds lifted cloth hides part of it."""

_TIP_RADIUS = (0.02, 0.08)
"""Bounds of half the width of a tool or a hand, over the cloth's extent."""

_MOST_CUT = 0.25
"""Largest share of the cloth that the picture's border cuts off."""

_WAVES = (5, 6)
"""Rows and columns of the coarse field that the slowly varying error is interpolated in."""

_FACING_DOWN = (1.0, -1.0, -1.0)


@dataclass(frozen=True, eq=False)
class Scenes:
    """Cameras, sensors and occluders, one of each per picture.

    Attributes:
        rotation, position: pose of the camera in the world [m]; columns are its axes.
        focal: focal length [pixels].
        wave: coarse field of the slowly varying error, in standard deviations.
        grown: pixels by which the mask is too large; negative: too small.
        tip: vertex that a tool or a hand is at, as a share of all from 0 to 1; negative: no tool.
        tip_radius_m: half of the tool's width [m].
        tip_angle: direction that the tool comes from in the picture [rad].
        reaches: whether the tool comes from beyond the picture's border.
        cut_side: side of the picture that is cut off, 0 to 3; negative: none.
        cut_share: share of the cloth that is cut off.
    """

    rotation: Float[Tensor, "batch 3 3"]
    position: Float[Tensor, "batch 3"]
    focal: Float[Tensor, " batch"]
    white_m: Float[Tensor, " batch"]
    wave_m: Float[Tensor, " batch"]
    disparity_step_m: Float[Tensor, " batch"]
    step_m: Float[Tensor, " batch"]
    dropout: Float[Tensor, " batch"]
    grazing_dropout: Float[Tensor, " batch"]
    edge_dropout: Float[Tensor, " batch"]
    edge_mixing: Float[Tensor, " batch"]
    edge_step_m: Float[Tensor, " batch"]
    wave: Float[Tensor, "batch down across"]
    grown: Int[Tensor, " batch"]
    tip: Float[Tensor, " batch"]
    tip_radius_m: Float[Tensor, " batch"]
    tip_angle: Float[Tensor, " batch"]
    reaches: Bool[Tensor, " batch"]
    cut_side: Int[Tensor, " batch"]
    cut_share: Float[Tensor, " batch"]


def draw_scenes(
    low: Float[Tensor, "batch 3"],
    high: Float[Tensor, "batch 3"],
    config: RenderConfig,
    generator: Generator,
) -> Scenes:
    """Draw a camera and occluders for each cloth.

    Args:
        low: least coordinates of the cloth in the world [m], on the CPU.
        high: largest coordinates [m].
    """
    count, extent = len(low), (high - low)[:, :2].amax(1)
    even = _Even(count, generator)
    rotation = _tilted_down(config, even)
    cameras = {
        "rotation": rotation,
        "position": _positions(low, high, -rotation[:, :, 2], config, even),
        "focal": even.between(*config.focal),
    }
    in_the_air = high[:, 2] > _HELD_HEIGHT * extent
    shown = even() < torch.where(in_the_air, HELD, config.tool)
    # Lifted cloth is held at its top, which a share of 1 selects.
    tip = torch.where(in_the_air, torch.ones(count), even() * (1.0 - 1e-6))
    grown = torch.floor(even.between(1.0, 4.0)).int()
    way = even()
    is_cut = even() < config.cut
    return Scenes(
        **{name: value.float() for name, value in cameras.items()},
        **_sensors(config, even),
        wave=torch.randn(count, *_WAVES, generator=generator),
        grown=torch.where(
            way < config.mask_jitter, grown, torch.where(way < 2.0 * config.mask_jitter, -grown, 0)
        ),
        tip=torch.where(shown, tip, -1.0).float(),
        tip_radius_m=(extent * even.between(*_TIP_RADIUS)).float(),
        tip_angle=(2.0 * torch.pi * even()).float(),
        reaches=even() >= 0.5,
        cut_side=torch.where(is_cut, torch.floor(4.0 * even()).int(), -1),
        cut_share=even.between(0.0, _MOST_CUT).float(),
    )


@dataclass(frozen=True, eq=False)
class _Even:
    """Uniform draws from 0 to 1 for a number of pictures."""

    count: int
    generator: Generator

    def __call__(self) -> Float[Tensor, " batch"]:
        return torch.rand(self.count, generator=self.generator, dtype=torch.float64)

    def between(self, low: float, high: float) -> Float[Tensor, " batch"]:
        """Return uniform draws between two bounds."""
        return low + (high - low) * self()


def _tilted_down(config: RenderConfig, even: _Even) -> Float[Tensor, "batch 3 3"]:
    """Return axes of cameras that look down, most of them nearly vertically."""
    tilt = torch.randn(even.count, 2, generator=even.generator, dtype=torch.float64)
    tilt = torch.deg2rad(torch.tensor(config.tilt_deg)) * tilt
    heading, angle = 2.0 * torch.pi * even(), torch.deg2rad(even.between(0.0, MOST_TILT_DEG))
    aside = angle[:, None] * torch.stack([heading.cos(), heading.sin()], 1)
    tilt = torch.where((even() < config.tilted)[:, None], aside, tilt)
    angle = tilt.norm(dim=1).clamp(min=1e-12)
    x, y = (tilt / angle[:, None]).unbind(1)
    sine, cosine = angle.sin(), angle.cos()
    rest = 1.0 - cosine
    rows = [
        cosine + x * x * rest, x * y * rest, y * sine,
        x * y * rest, cosine + y * y * rest, -x * sine,
        -y * sine, x * sine, cosine,
    ]  # fmt: skip
    turned = torch.stack(rows, 1).view(-1, 3, 3)
    return torch.tensor(_FACING_DOWN, dtype=torch.float64)[:, None] * turned


def _positions(
    low: Float[Tensor, "batch 3"],
    high: Float[Tensor, "batch 3"],
    backwards: Float[Tensor, "batch 3"],
    config: RenderConfig,
    even: _Even,
) -> Float[Tensor, "batch 3"]:
    """Return camera positions [m], from the cloth's extent and the direction away from it."""
    extent = (high - low)[:, :2].amax(1).double()
    target = 0.5 * (low + high).double()
    target[:, 0] += extent * even.between(-config.offset, config.offset)
    target[:, 1] += extent * even.between(-config.offset, config.offset)
    distance = extent * even.between(*config.distance)
    distance = torch.minimum(distance, (1.2 * extent).clamp(min=USUAL_DISTANCE_M))
    # Keep clear of cloth that is lifted towards the camera.
    distance = distance.clamp(min=LEAST_DISTANCE_M) + 0.5 * (high - low)[:, 2]
    return target + distance[:, None] * backwards


def _sensors(config: RenderConfig, even: _Even) -> dict[str, Float[Tensor, " batch"]]:
    """Return settings of sensors of random kinds, with random noise levels."""
    kinds = config.sensors
    scale = even.between(*config.noise_range).float()
    kind = torch.floor(len(kinds) * even()).long()

    def of(name: str) -> Float[Tensor, " batch"]:
        return torch.tensor([float(getattr(one, name)) for one in kinds])[kind]

    found = {name: of(name) for name in _FIXED}
    found |= {name: scale * of(name) for name in ("white_m", "wave_m")}
    return found | {name: (scale * of(name)).clamp(max=1.0) for name in _LOST}


_FIXED = ("disparity_step_m", "step_m", "edge_mixing", "edge_step_m")
_LOST = ("dropout", "grazing_dropout", "edge_dropout")
