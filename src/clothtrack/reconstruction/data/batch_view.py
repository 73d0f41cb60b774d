"""The network's pictures of a batch: each cloth seen by a virtual camera straight above.

The result is that of `view.py: crop`, on any PyTorch device and without Warp. Measured pixels are
joined to a surface, and the virtual camera renders its triangles.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from clothtrack.reconstruction.data.batch_pictures import Measured
from clothtrack.reconstruction.data.batch_raster import Projected, nearest_faces, unpacked
from clothtrack.reconstruction.data.view import (
    CLEAR,
    JUMP_M,
    LEAST_PIXELS,
    OUTLIERS,
    ViewConfig,
)

LATTICE = 64
"""Maximum number of evenly spaced rows and columns of measured pixels that determine the virtual
camera's position. A percentile of a thousand points is within a pixel of the network's picture of
that of all points."""

_DOWNWARDS = (1.0, -1.0, -1.0)


@dataclass(frozen=True, eq=False)
class Views:
    """The network's pictures.

    Attributes:
        depth: distance along the virtual camera's optical axis [m]; 0 where there is no cloth.
        position: position of the virtual camera in the world [m].
        rotation: rotation from the real camera's frame to the virtual one's; it includes a
            reflection if the world is mirrored.
        shift: position of the real camera in the virtual one's frame [m].
        focal: focal length of the virtual camera [pixels].
        is_cloth: whether enough cloth was measured for a picture.
    """

    depth: Float[Tensor, "batch size size"]
    position: Float[Tensor, "batch 3"]
    rotation: Float[Tensor, "batch 3 3"]
    shift: Float[Tensor, "batch 3"]
    focal: float
    is_cloth: Bool[Tensor, " batch"]

    def points(self, pixels: Int[Tensor, "batch asked 2"]) -> Float[Tensor, "batch asked 3"]:
        """Return measured points of pixels (row, column), in the frame of the real camera [m]."""
        rows, columns = pixels.unbind(2)
        size = self.depth.shape[1]
        depth = self.depth.flatten(1).gather(1, rows * size + columns)
        middle = 0.5 * (size - 1)
        x, y = (columns - middle) / self.focal * depth, (rows - middle) / self.focal * depth
        return (torch.stack([x, y, depth], 2) - self.shift[:, None]) @ self.rotation


def above(
    measured: Measured,
    world: Float[Tensor, "batch 3 3"],
    config: ViewConfig,
) -> Views:
    """Return the network's pictures of measured depth."""
    scenes = measured.cloths.scenes
    to_world = world @ scenes.rotation
    origin = (world @ scenes.position[..., None])[..., 0]
    position = _camera_positions(measured, to_world, origin, config)
    down = torch.tensor(_DOWNWARDS, device=position.device)
    rotation = down[:, None] * to_world
    shift = down * (origin - position)
    size = config.image_size
    focal = 0.5 * size / math.tan(math.radians(config.field_of_view_deg) / 2.0)
    points = _seen_from(measured, rotation, shift, focal, 0.5 * (size - 1))
    corners = _joined(measured)
    count, height, width = measured.depth.shape
    picture = torch.div(corners[0], height * width, rounding_mode="floor")
    drawn, face = unpacked(nearest_faces(points, corners, picture, (count, size, size)))
    depth = drawn.masked_fill_(face < 0, 0.0).view(count, size, size)
    is_cloth = measured.mask.sum((1, 2)) >= LEAST_PIXELS
    is_cloth = is_cloth & (depth > 0.0).flatten(1).any(1)
    return Views(depth, position, rotation, shift, focal, is_cloth)


def _camera_positions(
    measured: Measured,
    to_world: Float[Tensor, "batch 3 3"],
    origin: Float[Tensor, "batch 3"],
    config: ViewConfig,
) -> Float[Tensor, "batch 3"]:
    """Return positions of the virtual cameras in the world [m] (`view.py: view_camera`)."""
    step = -(-max(measured.depth.shape[1:]) // LATTICE)
    depth = measured.depth[:, ::step, ::step]
    shown = measured.mask[:, ::step, ::step].flatten(1)
    rays = _rays(measured.across[:, ::step], measured.down[:, ::step])
    points = [(one * depth).flatten(1) for one in rays]
    x, y, z = (
        sum(to_world[:, row, axis, None] * points[axis] for axis in range(3)) + origin[:, row, None]
        for row in range(3)
    )
    low, high = zip(*(_ends(one, shown) for one in (x, y, z)), strict=True)
    middle = [0.5 * (one + other) for one, other in zip(low[:2], high[:2], strict=True)]
    side = torch.maximum(high[0] - low[0], high[1] - low[1]) * (1.0 + 2.0 * config.view_margin)
    half = math.tan(math.radians(config.field_of_view_deg) / 2.0)
    # Raise the camera so that lifted cloth stays in the picture and below the camera.
    out = torch.maximum((x - middle[0][:, None]).abs(), (y - middle[1][:, None]).abs())
    _, in_view = _ends(out / half + z - low[2][:, None], shown)
    up = torch.maximum(0.5 * side.clamp(min=config.least_view_m) / half, in_view)
    up = torch.maximum(up, CLEAR * (high[2] - low[2]))
    return torch.stack([*middle, low[2] + up], 1)


def _ends(
    values: Float[Tensor, "batch points"], shown: Bool[Tensor, "batch points"]
) -> tuple[Float[Tensor, " batch"], Float[Tensor, " batch"]]:
    """Return bounds of the shown values without outliers; 0 and 0 if none is shown."""
    share = OUTLIERS / 100.0
    last = (shown.sum(1) - 1).clamp(min=0)
    place = (share * last)[:, None]
    before = place.floor().long()
    count = min(int(share * values.shape[1]) + 3, values.shape[1])
    found = []
    for sign in (1.0, -1.0):
        least = (sign * values).masked_fill(~shown, torch.inf)
        least = least.topk(count, largest=False).values
        after = torch.minimum(before + 1, last[:, None])
        value = torch.lerp(least.gather(1, before), least.gather(1, after), place - before)
        found.append(sign * value.nan_to_num(0.0, 0.0, 0.0)[:, 0])
    return found[0], found[1]


def _rays(
    across: Float[Tensor, "batch width"], down: Float[Tensor, "batch height"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the line of sight of each pixel at depth 1, in broadcastable parts."""
    return across[:, None], down[..., None], torch.ones_like(across[:, None])


def _seen_from(
    measured: Measured,
    rotation: Float[Tensor, "batch 3 3"],
    shift: Float[Tensor, "batch 3"],
    focal: float,
    middle: float,
) -> Projected:
    """Return the projection of each measured pixel into the virtual cameras."""
    local = []
    for row in range(3):
        right, downwards, ahead = rotation[:, row].unbind(1)
        columns = (right[:, None] * measured.across + ahead[:, None])[:, None]
        ray = columns + (downwards[:, None] * measured.down)[..., None]
        local.append(ray.mul_(measured.depth).add_(shift[:, row, None, None]).view(-1))
    inverse = local[2].reciprocal_()
    columns = local[0].mul_(inverse).mul_(focal).add_(middle)
    rows = local[1].mul_(inverse).mul_(focal).add_(middle)
    return Projected(columns, rows, inverse)


def _joined(measured: Measured) -> Int[Tensor, "3 faces"]:
    """Return triangles between neighboring pixels of the whole batch (`view.py: _joined`)."""
    depth, shown = measured.depth, measured.mask
    width = depth.shape[2]
    a, b = (depth[:, :-1, :-1], shown[:, :-1, :-1]), (depth[:, :-1, 1:], shown[:, :-1, 1:])
    c, d = (depth[:, 1:, :-1], shown[:, 1:, :-1]), (depth[:, 1:, 1:], shown[:, 1:, 1:])
    both = b[1] & c[1]
    low, high = torch.minimum(b[0], c[0]), torch.maximum(b[0], c[0])
    joined = torch.zeros_like(shown)
    faces = []
    for (other, is_shown), offset in ((a, 0), (d, width + 1)):
        apart = torch.maximum(high, other) - torch.minimum(low, other)
        joined[:, :-1, :-1] = (both & is_shown).logical_and_(apart < JUMP_M)
        first = joined.view(-1).nonzero()[:, 0]
        rest = (first + width, first + 1) if offset == 0 else (first + 1, first + width)
        faces.append(torch.stack([first + offset, *rest]))
    return torch.cat(faces, 1)


_TINY = 1e-20


class OnMesh(NamedTuple):
    """Locations on a mesh.

    Attributes:
        corners: vertices of the face that each location is on.
        weights: weights of the corners; not negative, and their sum is 1.
        apart: distance of the location from its point [m]; infinite without a face.
    """

    corners: Int[Tensor, "batch points 3"]
    weights: Float[Tensor, "batch points 3"]
    apart: Float[Tensor, "batch points"]


def on_mesh(points: Float[Tensor, "batch points 3"], measured: Measured) -> OnMesh:
    """Return the mesh locations of points (`labeled_picture.py: faces_of_points`).

    A point is projected to the face that its picture shows at its pixel. Of the four pixels around
    it, the one with the nearest depth is used.

    Args:
        points: points on the measured surface, in the frames of the cameras [m].
    """
    cloths = measured.cloths
    count, height, width = measured.depth.shape
    depth = points[..., 2]
    seen = points[..., :2] / depth[..., None] * cloths.scenes.focal[:, None, None]
    corner = (seen - cloths.first[:, None]).floor_()
    start = torch.arange(count, device=depth.device)[:, None] * (height * width)
    depths, faces = measured.depth.view(-1), measured.face.view(-1)
    shown = measured.mask.view(-1)
    best = torch.full_like(depth, torch.inf)
    face = torch.full(depth.shape, -1, device=depth.device)
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
        column = (corner[..., 0] + right).clamp_(0, width - 1)
        row = (corner[..., 1] + down).clamp_(0, height - 1)
        where = start + (row * width + column).long()
        gap = (depths[where] - depth).abs_().masked_fill_(~shown[where], torch.inf)
        nearer = gap < best
        face = torch.where(nearer, faces[where], face)
        best = torch.where(nearer, gap, best)
    index = face.clamp(min=0)[:, None].expand(-1, 3, -1)
    corners = cloths.faces.gather(2, index).transpose(1, 2)
    at = cloths.local.gather(1, corners.reshape(count, -1)[..., None].expand(-1, -1, 3))
    at = at.view(*corners.shape, 3)
    weights = closest_on_triangle(points, at)
    apart = ((weights[..., None] * at).sum(2) - points).norm(dim=2)
    return OnMesh(corners, weights, apart.masked_fill(face < 0, torch.inf))


def closest_on_triangle(
    points: Float[Tensor, "*batch 3"], corners: Float[Tensor, "*batch 3 3"]
) -> Float[Tensor, "*batch 3"]:
    """Return barycentric coordinates of the closest point on each triangle to its point.

    This is the projection if it is inside the triangle, else the closest point on an edge.
    """
    a, b, c = corners.unbind(-2)
    sides, starts = (b - a, c - b, a - c), (a, b, c)
    v, w = _projected(points - a, b - a, c - a)
    zero = torch.zeros_like(v)
    best = torch.stack([1.0 - v - w, v, w], -1)
    least = torch.where((v >= 0.0) & (w >= 0.0) & (v + w <= 1.0), -1.0, torch.inf)
    for start in range(3):
        away, side = points - starts[start], sides[start]
        length = side.square().sum(-1).clamp_(min=_TINY)
        share = ((away * side).sum(-1) / length).clamp_(0.0, 1.0)
        gap = (away - share[..., None] * side).square().sum(-1)
        rows = [zero, zero, zero]
        rows[start], rows[(start + 1) % 3] = 1.0 - share, share
        nearer: Bool[Tensor, "*batch"] = gap < least
        best = torch.where(nearer[..., None], torch.stack(rows, -1), best)
        least = torch.where(nearer, gap, least)
    return best


def _projected(
    away: Float[Tensor, "*batch 3"], ab: Float[Tensor, "*batch 3"], ac: Float[Tensor, "*batch 3"]
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """Return weights of the second and third corner at the projection to a triangle's plane."""
    d00, d01, d11 = (ab * ab).sum(-1), (ab * ac).sum(-1), (ac * ac).sum(-1)
    d20, d21 = (away * ab).sum(-1), (away * ac).sum(-1)
    determinant = d00 * d11 - d01 * d01
    # A sliver has no interior, so its weights are NaN and an edge is used instead.
    safe = torch.where(determinant > _TINY, determinant, torch.full_like(d00, torch.nan))
    return (d11 * d20 - d01 * d21) / safe, (d00 * d21 - d01 * d20) / safe
