"""A rasterizer for many pictures at once, on any PyTorch device.

It is a z-buffer without Warp (`geometry/visibility.py` has the tracker's). All triangles of all
pictures become one list of rows, and all rows one list of pixels, so triangles may have any size
and nothing is padded. A pixel is one 64-bit number with the bits of its depth above the index of
its face. The smallest number wins in any order, so results are deterministic and equal on CPU and
GPU.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

EMPTY_PIXEL = 2**63 - 1
"""Value of a pixel that no face covers."""

_SEAM_PIXELS = 1e-3
"""Widening of faces [pixels]; a pixel center on an edge belongs to both faces, without gaps."""

_LOWER_HALF = 2**32 - 1
_LEVEL = 1e-7
_FAR = 1e36


@dataclass(frozen=True, eq=False)
class Projected:
    """Points projected into the pictures of their cameras, concatenated over pictures.

    Attributes:
        columns, rows: image coordinates [pixels]; pixel centers at integers.
        inverse: inverse depth along the optical axis [1/m]; not positive behind the camera.
    """

    columns: Float[Tensor, " points"]
    rows: Float[Tensor, " points"]
    inverse: Float[Tensor, " points"]


def nearest_faces(
    points: Projected,
    faces: Int[Tensor, "3 faces"],
    picture: Int[Tensor, " faces"],
    shape: tuple[int, int, int],
) -> Int[Tensor, " pixels"]:
    """Draw faces into pictures of one size, and return the packed pixels (`unpacked`).

    A face with a corner behind its camera is not drawn.

    Args:
        shape: number of pictures, their height and width [pixels].
    """
    count, height, width = shape
    pixels = torch.full(
        (count * height * width,), EMPTY_PIXEL, dtype=torch.int64, device=picture.device
    )
    boxes = _boxes(points, faces, height, width)
    drawn = (boxes.down * boxes.across).nonzero()[:, 0]
    if len(drawn) == 0:
        return pixels
    boxes = _Boxes(*(one.index_select(0, drawn) for one in boxes))
    corners = faces.index_select(1, drawn)
    first = (picture.index_select(0, drawn) * height + boxes.top.long()) * width
    spans = _spans(points, corners, boxes, first + boxes.left.long(), width)
    owner, place = _expanded(spans.pixels)
    where = place + spans.first.index_select(0, owner)
    inverse = spans.inverse.index_select(0, owner)
    inverse.addcmul_(place.float(), spans.slope.index_select(0, owner))
    key = inverse.reciprocal_().view(torch.int32).long().bitwise_left_shift_(32)
    face = drawn.index_select(0, spans.owner)
    key = key.bitwise_or_(face.index_select(0, owner))
    return pixels.scatter_reduce_(0, where, key, "amin")


def unpacked(
    pixels: Int[Tensor, " pixels"],
) -> tuple[Float[Tensor, " pixels"], Int[Tensor, " pixels"]]:
    """Return depth [m] and face of each pixel; without a face, depth infinity and face -1."""
    empty = pixels == EMPTY_PIXEL
    depth = pixels.bitwise_right_shift(32).int().view(torch.float32)
    face = pixels.bitwise_and(_LOWER_HALF)
    return depth.masked_fill(empty, torch.inf), face.masked_fill_(empty, -1)


class _Boxes(NamedTuple):
    """Bounding box of each face: first column and row, number of columns and rows (0: none)."""

    left: Float[Tensor, " faces"]
    top: Float[Tensor, " faces"]
    across: Float[Tensor, " faces"]
    down: Float[Tensor, " faces"]


class _Spans(NamedTuple):
    """Rows of faces that cover at least one pixel.

    Attributes:
        first: index of its first pixel in this row, over all pictures.
        pixels: number of pixels that it covers.
        inverse, slope: inverse depth [1/m] at the first pixel, and its change per pixel.
    """

    owner: Int[Tensor, " spans"]
    first: Int[Tensor, " spans"]
    pixels: Int[Tensor, " spans"]
    inverse: Float[Tensor, " spans"]
    slope: Float[Tensor, " spans"]


def _boxes(points: Projected, faces: Int[Tensor, "3 faces"], height: int, width: int) -> _Boxes:
    left, right = _within(points.columns, faces, width)
    top, bottom = _within(points.rows, faces, height)
    a, b, c = (points.inverse.index_select(0, corner) for corner in faces)
    before = (torch.minimum(torch.minimum(a, b), c) > 0.0).float()
    across, down = (right - left + 1.0).clamp_(min=0.0), (bottom - top + 1.0).clamp_(min=0.0)
    return _Boxes(left, top, across * before, down)


def _within(
    values: Float[Tensor, " points"], faces: Int[Tensor, "3 faces"], size: int
) -> tuple[Float[Tensor, " faces"], Float[Tensor, " faces"]]:
    """Return the first and last pixel along one axis that each face can cover."""
    a, b, c = (values.index_select(0, corner) for corner in faces)
    low = torch.minimum(torch.minimum(a, b), c).sub_(_SEAM_PIXELS).ceil_().clamp_(min=0.0)
    high = torch.maximum(torch.maximum(a, b), c).add_(_SEAM_PIXELS).floor_().clamp_(max=size - 1.0)
    return low, high


def _expanded(counts: Int[Tensor, " owners"]) -> tuple[Int[Tensor, " all"], Int[Tensor, " all"]]:
    """Return each owner's index repeated by its count, and the number of each repetition."""
    ends = counts.cumsum(0)
    total = int(ends[-1]) if len(ends) else 0
    # Sum a step of 1 at the end of each owner; on a CPU this is faster than repeating the index.
    owner = torch.zeros(total + 1, dtype=torch.int64, device=counts.device)
    owner = owner.scatter_add_(0, ends, torch.ones_like(ends))[:total].cumsum_(0)
    place = torch.arange(total, device=counts.device)
    return owner, place.sub_((ends - counts).index_select(0, owner))


def _spans(
    points: Projected,
    faces: Int[Tensor, "3 faces"],
    boxes: _Boxes,
    first: Int[Tensor, " faces"],
    width: int,
) -> _Spans:
    """Return the span of each row of each face, bounded by where its edges cross the row.

    Args:
        width: width of a picture [pixels].
    """
    # Coordinates are relative to the boxes, because small numbers are more precise.
    ax, bx, cx = (points.columns.index_select(0, one) - boxes.left for one in faces)
    ay, by, cy = (points.rows.index_select(0, one) - boxes.top for one in faces)
    az, bz, cz = (points.inverse.index_select(0, one) for one in faces)
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    owner, number = _expanded((boxes.down * (area != 0.0)).long())
    row = number.float()
    left = torch.zeros_like(row)
    right = (boxes.across - 1.0).index_select(0, owner)
    for fx, fy, tx, ty in ((ax, ay, bx, by), (bx, by, cx, cy), (cx, cy, ax, ay)):
        begins, ends, change = _crossing(fx, fy, tx, ty, area.sign())
        along = row * change.index_select(0, owner)
        left = torch.maximum(left, begins.index_select(0, owner) + along)
        right = torch.minimum(right, ends.index_select(0, owner) + along)
    left, right = left.ceil_(), right.floor_()
    held = (right >= left).nonzero()[:, 0]
    owner, number, row, left, right = (
        one.index_select(0, held) for one in (owner, number, row, left, right)
    )
    east = ((bz - az) * (cy - ay) - (cz - az) * (by - ay)) / area
    south = ((cz - az) * (bx - ax) - (bz - az) * (cx - ax)) / area
    start = (az - ax * east - ay * south).index_select(0, owner)
    start.addcmul_(row, south.index_select(0, owner))
    # Clamp to the face's depths: a sliver's plane is so steep that it is wrong in the seam.
    nearest = torch.maximum(torch.maximum(az, bz), cz).index_select(0, owner)
    farthest = torch.minimum(torch.minimum(az, bz), cz).index_select(0, owner)
    east = east.index_select(0, owner)
    begin = torch.maximum(torch.minimum(start + left * east, nearest), farthest)
    end = torch.maximum(torch.minimum(start + right * east, nearest), farthest)
    step = (end - begin) / (right - left).clamp_(min=1.0)
    first = first.index_select(0, owner) + number * width + left.long()
    return _Spans(owner, first, (right - left).long() + 1, begin, step)


def _crossing(
    fx: Float[Tensor, " faces"],
    fy: Float[Tensor, " faces"],
    tx: Float[Tensor, " faces"],
    ty: Float[Tensor, " faces"],
    turn: Float[Tensor, " faces"],
) -> tuple[Float[Tensor, " faces"], Float[Tensor, " faces"], Float[Tensor, " faces"]]:
    """Return the bounds that one edge sets for faces along row 0, and their change per row."""
    east, south = (fy - ty) * turn, (tx - fx) * turn
    seam = _SEAM_PIXELS * (east.abs() + south.abs())
    # A horizontal edge has a whole row on one side, which a far crossing expresses as well.
    east = torch.where(east.abs() < _LEVEL, _LEVEL, east)
    change = -south / east
    at = fx - fy * change - seam / east
    # The bound that this edge does not set is infinitely far; this is faster than a branch.
    far = east * _FAR
    return torch.minimum(at, far), torch.maximum(at, far), change
