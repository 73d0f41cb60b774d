"""Projection of measured points to their meshes, for a batch of pictures."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from clothtrack.reconstruction.data.batch_pictures import Measured

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
