"""Depth camera noise for a batch of perfect depth pictures: `sensor_noise.py` on any device.

All pictures of a batch have the same size; every sensor parameter has one value per picture.
"""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float, Int
from torch import Generator, Tensor

from clothtrack.reconstruction.data.batch_draws import Scenes
from clothtrack.reconstruction.data.sensor_noise import REFERENCE_DEPTH_M
from clothtrack.recordings.camera_view import LEAST_JUMP_M

_GRAZING = 0.4
"""Cosine between normal and line of sight below which surfaces begin to drop out."""

_STEEP_PIXELS = 6.0
"""Depth step between neighboring pixels of a surface tilted by 80 degrees, in pixel widths."""

_CUBIC = -0.75

Pictures = Float[Tensor, "batch height width"]
Masks = Bool[Tensor, "batch height width"]


def measured_depth(
    depth: Pictures, facing: Pictures, wave: Pictures, sensors: Scenes, generator: Generator
) -> Pictures:
    """Return the measured depth [m] for perfect depth pictures; 0 = no measurement.

    Args:
        depth: true depth [m], positive everywhere.
    """

    def each(values: Float[Tensor, " batch"]) -> Float[Tensor, "batch 1 1"]:
        return values[:, None, None]

    def even() -> Pictures:
        return torch.rand(depth.shape, generator=generator, device=depth.device)

    near, far = _around(depth, torch.minimum), _around(depth, torch.maximum)
    jump = far.sub_(near)
    edge = jump > each(sensors.edge_step_m)
    # One draw decides whether a pixel mixes, and its position between both depths.
    drawn = even().div_(each(sensors.edge_mixing.clamp(min=1e-6)))
    mixed = near.addcmul_(jump, drawn)
    error = torch.randn(depth.shape, generator=generator, device=depth.device)
    error.mul_(each(sensors.white_m)).addcmul_(wave, each(sensors.wave_m))
    found = torch.where(edge & (drawn < 1.0), mixed, depth)
    found.addcmul_(depth.div(REFERENCE_DEPTH_M).square_(), error)
    lost = (_GRAZING - facing).div_(_GRAZING).clamp_(0.0, 1.0)
    lost.mul_(each(sensors.grazing_dropout)).add_(each(sensors.dropout)).clamp_(max=1.0)
    lost.add_((1.0 - lost).mul_(edge).mul_(each(sensors.edge_dropout)))
    in_steps = (sensors.disparity_step_m > 0.0).nonzero()[:, 0]
    step = each(sensors.disparity_step_m.index_select(0, in_steps) / REFERENCE_DEPTH_M**2)
    disparity = found.index_select(0, in_steps).clamp_(min=1e-3).reciprocal_()
    disparity = torch.maximum(disparity.div_(step).round_().mul_(step), step)
    found.index_copy_(0, in_steps, disparity.reciprocal_())
    unit = each(sensors.step_m)
    found = found.div_(unit).round_().mul_(unit).clamp_(min=0.0)
    return found.mul_(even() >= lost)


def flying(depth: Pictures, focal: Float[Tensor, " batch"]) -> Masks:
    """Return pixels that mix two surfaces (`recordings/camera_view.py: flying_pixels`).

    Args:
        depth: measured depth [m].
        focal: focal length of each camera [pixels].
    """
    found = torch.zeros(depth.shape, dtype=torch.bool, device=depth.device)
    limit = depth * (_STEEP_PIXELS / focal)[:, None, None] + LEAST_JUMP_M
    measured = depth > 0.0
    for axis in (1, 2):
        size = depth.shape[axis]
        steps = depth.narrow(axis, 1, size - 1) - depth.narrow(axis, 0, size - 1)
        before, after = steps.narrow(axis, 0, size - 2), steps.narrow(axis, 1, size - 2)
        least, most = torch.minimum(before, after), torch.maximum(before, after)
        inner = limit.narrow(axis, 1, size - 2)
        climbs = (least > inner) & measured.narrow(axis, 0, size - 2)
        falls = (-most > inner) & measured.narrow(axis, 2, size - 2)
        found.narrow(axis, 1, size - 2).logical_or_(climbs.logical_or_(falls))
    return found


def jittered(masks: Masks, grown: Int[Tensor, " batch"]) -> Masks:
    """Return masks with segmentation errors, some pixels too large or too small."""
    chosen = grown.nonzero()[:, 0]
    pixels = grown.index_select(0, chosen)[:, None, None]
    shrinks = pixels < 0
    # Shrinking a mask is growing its complement.
    changed = masks.index_select(0, chosen).logical_xor_(shrinks)
    for step in range(1, 4):
        larger = _around(changed, torch.logical_or)
        changed = torch.where(pixels.abs() >= step, larger, changed)
    return masks.index_copy(0, chosen, changed.logical_xor_(shrinks))


def hidden_by_tools(
    tips: Float[Tensor, "batch 2"],
    radius: Float[Tensor, " batch"],
    scenes: Scenes,
    shape: tuple[int, int],
) -> Masks:
    """Return pixels that tools and hands hide: all near a line from their tips outwards.

    Args:
        tips: column and row of each tip [pixels].
        radius: half the width of each tool [pixels].
        shape: height and width of the pictures [pixels].
    """
    height, width = shape
    columns = torch.arange(width, device=tips.device)[None, None, :] - tips[:, 0, None, None]
    rows = torch.arange(height, device=tips.device)[None, :, None] - tips[:, 1, None, None]
    length = (height + width) * scenes.reaches.float()
    cosine, sine = (one[:, None, None] for one in (scenes.tip_angle.cos(), scenes.tip_angle.sin()))
    along = (columns * cosine + rows * sine).clamp_(min=0.0)
    along = torch.minimum(along, length[:, None, None])
    apart = (columns - along * cosine).square_() + (rows - along * sine).square_()
    return apart <= radius.clamp(min=0.5).square()[:, None, None]


def cut_off(masks: Masks, side: Int[Tensor, " batch"], share: Float[Tensor, " batch"]) -> Masks:
    """Return pixels that the borders of pictures cut off."""
    found = torch.zeros_like(masks)
    for number in range(4):
        chosen = (side == number).nonzero()[:, 0]
        axis = 2 if number % 2 == 0 else 1
        counts = masks.index_select(0, chosen).sum(3 - axis)
        counts = counts if number < 2 else counts.flip(1)
        ends = counts.cumsum(1)
        total = ends[:, -1:]
        # The quantile is the first place with more pixels up to it; pixels beyond it are cut.
        rank = torch.floor((1.0 - share.index_select(0, chosen))[:, None] * (total - 1))
        beyond = ends - counts > rank
        beyond = beyond if number < 2 else beyond.flip(1)
        found.index_copy_(0, chosen, beyond.unsqueeze(3 - axis).expand(-1, *masks.shape[1:]))
    return found


def waves(
    coarse: Float[Tensor, "batch down across"],
    heights: Float[Tensor, " batch"],
    widths: Float[Tensor, " batch"],
    shape: tuple[int, int],
) -> Pictures:
    """Return smooth fields, each spread over its own picture by cubic interpolation.

    Args:
        heights: rows over which each field is spread [pixels].
        widths: columns over which each field is spread [pixels].
    """
    down = _cubic_weights(coarse.shape[1], heights, shape[0])
    across = _cubic_weights(coarse.shape[2], widths, shape[1])
    return down @ coarse @ across.transpose(1, 2)


def _cubic_weights(
    count: int, sizes: Float[Tensor, " batch"], length: int
) -> Float[Tensor, "batch length count"]:
    """Return the cubic interpolation weight of each value at each pixel, as in OpenCV's resize."""
    pixels = torch.arange(length, device=sizes.device) + 0.5
    at = pixels[None, :] * (count / sizes)[:, None] - 0.5
    whole = at.floor()
    weights = torch.zeros(*at.shape, count, device=sizes.device)
    for step in range(-1, 3):
        away = (whole + step - at).abs()
        near = ((_CUBIC + 2.0) * away - (_CUBIC + 3.0)) * away.square() + 1.0
        far = ((_CUBIC * away - 5.0 * _CUBIC) * away + 8.0 * _CUBIC) * away - 4.0 * _CUBIC
        weight = torch.where(away <= 1.0, near, far)
        index = (whole + step).clamp(0, count - 1).long()
        weights.scatter_add_(2, index[..., None], weight[..., None])
    return weights


def _around(pictures: Tensor, least_or_most: Callable[..., Tensor]) -> Tensor:
    """Return the least, or the most, of each pixel and its eight neighbors."""
    found = pictures
    for axis in (1, 2):
        size = found.shape[axis]
        wide = found.clone()
        for here, there in ((0, 1), (1, 0)):
            part = wide.narrow(axis, here, size - 1)
            least_or_most(part, found.narrow(axis, there, size - 1), out=part)
        found = wide
    return found
