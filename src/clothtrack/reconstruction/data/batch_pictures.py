"""Noisy depth pictures of many states at once, from cameras above them.

This runs on any PyTorch device, without Warp. Positions are in the frame of each picture's camera
until the network's picture is taken, so that mirroring and turning the world costs nothing.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Generator, Tensor

from clothtrack.reconstruction.data.batch_draws import Scenes
from clothtrack.reconstruction.data.batch_raster import Projected, nearest_faces, unpacked
from clothtrack.reconstruction.data.batch_rows import rows_of
from clothtrack.reconstruction.data.batch_sensor import (
    cut_off,
    flying,
    hidden_by_tools,
    jittered,
    measured_depth,
    waves,
)

_MARGIN_PIXELS = 6
"""Free space around the cloth in a picture [pixels]."""


@dataclass(frozen=True, eq=False)
class Cloths:
    """Cloths in front of their cameras, padded to the vertices and faces of the largest.

    Attributes:
        local: vertices in the frame of the camera [m]; those of a smaller cloth are repeated.
        faces: first, second and third corners of all faces; padding faces have the same vertex
            three times.
        first: column and row of each picture's first pixel, relative to the principal point
            [pixels].
        size: number of columns and rows of each picture [pixels].
    """

    local: Float[Tensor, "batch vertices 3"]
    faces: Int[Tensor, "batch 3 faces"]
    scenes: Scenes
    first: Float[Tensor, "batch 2"]
    size: Int[Tensor, "batch 2"]

    @classmethod
    def before(
        cls,
        positions: Float[Tensor, "batch vertices 3"],
        faces: Int[Tensor, "batch 3 faces"],
        scenes: Scenes,
    ) -> "Cloths":
        """Return cloths in front of the cameras of their scenes.

        Args:
            positions: vertices in the world [m].
        """
        local = (positions - scenes.position[:, None]) @ scenes.rotation
        seen = local[..., :2] / local[..., 2:] * scenes.focal[:, None, None]
        first = seen.amin(1).floor_() - _MARGIN_PIXELS
        size = (seen.amax(1).ceil_() + _MARGIN_PIXELS - first).long() + 1
        return cls(local, faces, scenes, first, size)

    def parts(self, most_pixels: int) -> Iterator[Int[Tensor, " part"]]:
        """Iterate over groups of cloths with pictures of similar size, to render together."""
        sizes = self.size.tolist()
        order = sorted(range(len(sizes)), key=lambda one: sizes[one][0] * sizes[one][1])
        begin = width = height = 0
        for place, one in enumerate(order):
            width, height = max(width, sizes[one][0]), max(height, sizes[one][1])
            if place > begin and (place - begin + 1) * width * height > most_pixels:
                yield torch.tensor(order[begin:place], device=self.size.device)
                begin, (width, height) = place, sizes[one]
        yield torch.tensor(order[begin:], device=self.size.device)


@dataclass(frozen=True, eq=False)
class Measured:
    """Depth pictures of cloths, padded with table to one size.

    Attributes:
        depth: measured depth [m]; 0 where nothing was measured.
        mask: segmentation of the cloth, where it was measured.
        face: face that each pixel shows; -1 for none.
        across, down: line of sight of each column and row at depth 1.
    """

    cloths: Cloths
    depth: Float[Tensor, "batch height width"]
    mask: Bool[Tensor, "batch height width"]
    face: Int[Tensor, "batch height width"]
    across: Float[Tensor, "batch width"]
    down: Float[Tensor, "batch height"]


def measure(cloths: Cloths, generator: Generator) -> Measured:
    """Take pictures of cloths on the table z = 0."""
    scenes = cloths.scenes
    width, height = (int(one) for one in cloths.size.amax(0))
    device = cloths.local.device
    columns, rows = torch.arange(width, device=device), torch.arange(height, device=device)
    across = (columns[None] + cloths.first[:, :1]) / scenes.focal[:, None]
    down = (rows[None] + cloths.first[:, 1:]) / scenes.focal[:, None]
    perfect, face, facing = _perfect_depth(cloths, across, down)
    wide, high = cloths.size.float().unbind(1)
    wave = waves(scenes.wave, high, wide, (height, width))
    depth = measured_depth(perfect, facing, wave, scenes, generator)
    mask = jittered(face >= 0, scenes.grown)
    mask.logical_and_(depth > 0.0).logical_and_(flying(depth, scenes.focal).logical_not_())
    hidden = _hidden(cloths, mask)
    return Measured(cloths, depth, mask.logical_and_(hidden.logical_not_()), face, across, down)


def _perfect_depth(
    cloths: Cloths, across: Float[Tensor, "batch width"], down: Float[Tensor, "batch height"]
) -> tuple[
    Float[Tensor, "batch height width"],
    Int[Tensor, "batch height width"],
    Float[Tensor, "batch height width"],
]:
    """Return depth [m] of cloth and table, faces, and cosine of normal and line of sight."""
    scenes, local = cloths.scenes, cloths.local
    count, vertices = local.shape[:2]
    shape = (count, down.shape[1], across.shape[1])
    inverse = local[..., 2].reciprocal()
    seen = local[..., :2] * inverse[..., None] * scenes.focal[:, None, None]
    seen = seen - cloths.first[:, None]
    points = Projected(*(one.reshape(-1) for one in (seen[..., 0], seen[..., 1], inverse)))
    number = torch.arange(count, device=local.device)
    corners = (cloths.faces + (number * vertices)[:, None, None]).transpose(0, 1).reshape(3, -1)
    picture = number.repeat_interleave(cloths.faces.shape[2])
    drawn, face = unpacked(nearest_faces(points, corners, picture, shape))
    # Distance of the plane of each face from the camera; the table's for pixels without a face.
    a, b, c = (local.view(-1, 3).index_select(0, corner) for corner in corners)
    normal = torch.linalg.cross(b - a, c - a)
    plane = (normal * a).sum(1).abs_() / normal.norm(dim=1).clamp_(min=1e-12)
    tall = scenes.position[:, 2]
    shown = face >= 0
    plane = torch.where(
        shown.view(shape),
        plane.index_select(0, face.clamp(min=0)).view(shape),
        tall[:, None, None],
    )
    # Intersect the line of sight with the table, using the change of world height along it.
    tilt = scenes.rotation[:, 2]
    slope = (tilt[:, :1] * across)[:, None] + (tilt[:, 1:2] * down + tilt[:, 2:])[..., None]
    table = tall[:, None, None] / slope.neg_().clamp_(min=1e-3)
    depth = torch.where(shown.view(shape), drawn.view(shape), table)
    length = (across.square()[:, None] + (down.square() + 1.0)[..., None]).sqrt_()
    facing = plane.div_(length.mul_(depth))
    # Number the faces from 0 in each picture.
    face = face.view(shape).sub_((number * cloths.faces.shape[2])[:, None, None])
    return depth, torch.where(shown.view(shape), face, -1), facing


def _hidden(
    cloths: Cloths, masks: Bool[Tensor, "batch height width"]
) -> Bool[Tensor, "batch height width"]:
    """Return pixels that tools and hands hide, or that the pictures' borders cut off."""
    scenes, found = cloths.scenes, cut_off(masks, cloths.scenes.cut_side, cloths.scenes.cut_share)
    chosen = (scenes.tip >= 0.0).nonzero()[:, 0]
    held = rows_of(cloths, chosen)
    # A share of 1 selects the highest vertex, any other share a vertex by its index.
    local, camera = held.local, held.scenes
    height = (local * camera.rotation[:, 2, None]).sum(2)
    count = local.shape[1]
    number = (camera.tip * count).long().clamp_(max=count - 1)
    number = torch.where(camera.tip < 1.0, number, height.argmax(1))
    tip = local.gather(1, number[:, None, None].expand(-1, 1, 3))[:, 0]
    pixel = (tip[:, :2] / tip[:, 2:] * camera.focal[:, None] - held.first).round_()
    radius = camera.focal / tip[:, 2].clamp(min=0.1) * camera.tip_radius_m
    by_tools = hidden_by_tools(pixel, radius, camera, (masks.shape[1], masks.shape[2]))
    return found.index_copy_(0, chosen, by_tools.logical_or_(found.index_select(0, chosen)))
