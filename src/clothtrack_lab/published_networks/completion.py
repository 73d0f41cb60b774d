"""Completion: from the visible part of a garment to all of it, in the canonical cube.

The features of the visible pixels are collected in a volume over the canonical cube, a 3-D U-Net
fills in the rest, and small networks read the volume at any position (GarmentNets, arXiv
2104.05177, 3.3). The axes of a volume are always x, y, z in that order. The published code reads
its volume with the axes reversed. Here a test ensures that a cell filled at (x, y, z) is read at
(x, y, z).
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from clothtrack.reconstruction.alignment_frame import Alignment, align
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack_lab.published_networks.canonical_frame import CanonicalFrame
from clothtrack_lab.published_networks.canonicalisation import Canonicaliser, coordinates
from clothtrack_lab.published_networks.network_config import NetworkConfig

RESIDUAL_M = 0.1
"""Displacement for an output of the warp field of 1 [m]."""

QUERIES_AT_ONCE = 1 << 17
"""Number of grid nodes decoded at once, to bound the memory."""

_GROUPS = 8


@dataclass(frozen=True, eq=False)
class ObservedPoints:
    """The visible points of a batch of pictures, concatenated.

    Attributes:
        features: features of each point's pixel.
        unit: canonical coordinates in the unit cube.
        confidence: confidence of each canonical coordinate, 0 to 1.
        aligned: measured position, rotated into the canonical frame (`alignment_frame`), in edges
            of the cube from its middle.
    """

    features: Float[Tensor, "points channels"]
    unit: Float[Tensor, "points 3"]
    confidence: Float[Tensor, "points 3"]
    aligned: Float[Tensor, "points 3"]
    image: Int[Tensor, " points"]
    images: int


def scatter_max(
    values: Float[Tensor, "points channels"],
    unit: Float[Tensor, "points 3"],
    image: Int[Tensor, " points"],
    images: int,
    cells: tuple[int, int, int],
) -> Float[Tensor, "images channels x y z"]:
    """Return the largest value per channel of the points in each cell of a box; 0 if empty."""
    wide, long, high = cells
    x, y, z = _cell_of(unit, cells).unbind(dim=1)
    index = ((image * wide + x) * long + y) * high + z
    flat = values.new_zeros(images * wide * long * high, values.shape[1])
    flat = flat.scatter_reduce(0, index[:, None].expand_as(values), values, reduce="amax")
    return flat.reshape(images, wide, long, high, -1).permute(0, 4, 1, 2, 3)


def _cell_of(
    unit: Float[Tensor, "points 3"], cells: tuple[int, int, int]
) -> Int[Tensor, "points 3"]:
    """Return the cell of a point in the box; cell k spans k / cells to (k + 1) / cells."""
    last = torch.tensor(cells, device=unit.device) - 1
    return torch.minimum((unit * (last + 1)).floor().long().clamp(min=0), last)


def in_box(unit: Float[Tensor, "*points 3"], config: NetworkConfig) -> Float[Tensor, "*points 3"]:
    """Return positions in the unit cube as positions in a volume's box, clipped to its walls.

    The box is the cube, cropped along z to `volume_depth` of `volume` cells about the middle.
    """
    stretch = unit.new_tensor((1.0, 1.0, config.volume / config.volume_depth))
    return (0.5 + (unit - 0.5) * stretch).clamp(0.0, 1.0)


def sample(
    volume: Float[Tensor, "batch channels x y z"], queries: Float[Tensor, "batch queries 3"]
) -> Float[Tensor, "batch queries channels"]:
    """Return a volume at positions in its box, linear between the centers of its cells."""
    # `grid_sample` takes the last axis first and runs from -1 to 1 between the outer cell walls.
    grid = (2.0 * queries - 1.0).flip(-1)[:, :, None, None, :]
    found = functional.grid_sample(
        # In half precision a position would be off by a tenth of a cell.
        volume.to(grid.dtype),
        grid,
        mode="bilinear",
        padding_mode="border",
        align_corners=False,
    )
    return found[..., 0, 0].transpose(1, 2)


def perceptron(widths: tuple[int, ...]) -> nn.Sequential:
    """Return linear layers with ReLU between them, none after the last."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class _VolumeUNet(nn.Module):
    """A 3-D U-Net: group norm, 3x3x3 convolution and ReLU, twice per resolution.

    Args:
        channels: channels of the volume in and out.
        widths: channels at each resolution, halved from one to the next.
    """

    def __init__(self, channels: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        befores = (channels, *widths[:-1])
        self.down = nn.ModuleList(
            _double(before, max(before, width // 2), width)
            for before, width in zip(befores, widths, strict=True)
        )
        self.up = nn.ModuleList(
            _double(below + width, width, width) for width, below in reversed([*pairwise(widths)])
        )
        self.last = nn.Conv3d(widths[0], channels, 1)

    def forward(
        self, volume: Float[Tensor, "batch channels x y z"]
    ) -> Float[Tensor, "batch channels x y z"]:
        """Return the completed volume."""
        skips = []
        for level, block in enumerate(self.down):
            volume = block(volume if level == 0 else functional.max_pool3d(volume, 2))
            skips.append(volume)
        for block, skip in zip(self.up, reversed(skips[:-1]), strict=True):
            volume = functional.interpolate(volume, size=skip.shape[-3:], mode="nearest")
            volume = block(torch.cat([skip, volume], dim=1))
        return self.last(volume)


class Completion(nn.Module):
    """A network from visible points to a feature volume and the winding number in it.

    Args:
        point_channels: channels of a pixel's feature.
    """

    def __init__(self, config: NetworkConfig, point_channels: int) -> None:
        super().__init__()
        self.config = config
        # A point's input includes its position in its cell, its measured position and its
        # confidence.
        hidden, channels = config.point_hidden, config.volume_channels
        self.points = perceptron((point_channels + 9, hidden, hidden, channels))
        self.unet = _VolumeUNet(channels, config.volume_widths)
        wide = config.decoder_hidden
        self.winding_decoder = perceptron((channels, wide, wide, 1))

    def forward(self, points: ObservedPoints) -> Float[Tensor, "images channels x y z"]:
        """Return the completed volume of each picture."""
        cells = self.config.volume_cells
        places = in_box(points.unit, self.config)
        in_cell = places * places.new_tensor(cells) - (_cell_of(places, cells) + 0.5)
        known = torch.cat([points.features, in_cell, points.aligned, points.confidence], dim=1)
        values = functional.relu(self.points(known))
        return self.unet(scatter_max(values, places, points.image, points.images, cells))

    def winding(
        self,
        volume: Float[Tensor, "batch channels x y z"],
        queries: Float[Tensor, "batch queries 3"],
    ) -> Float[Tensor, "batch queries"]:
        """Return the winding number of the canonical garment at positions in the unit cube."""
        return self.winding_decoder(sample(volume, in_box(queries, self.config)))[..., 0]

    def field(
        self,
        volume: Float[Tensor, "batch channels x y z"],
        nodes: Float[Tensor, "nodes 3"],
    ) -> Float[Tensor, "batch nodes"]:
        """Return the winding number at many positions, the same ones for every picture."""
        pieces = [
            self.winding(volume, piece.expand(len(volume), -1, -1))
            for piece in nodes.split(QUERIES_AT_ONCE)
        ]
        return torch.cat(pieces, dim=1)


class WarpField(nn.Module):
    """A decoder of the displacement of canonical points from the completed volume.

    It starts from the canonical pose (MEDOR, arXiv 2209.03287, 3.2), after the observation has been
    rotated into the canonical frame, so that the network need not learn rotations of the cloth.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        wide = config.decoder_hidden
        self.decoder = perceptron((config.volume_channels + 3, wide, wide, 3))
        # The untrained network predicts the canonical pose.
        last = self.decoder[-1]
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)

    def forward(
        self,
        volume: Float[Tensor, "batch channels x y z"],
        queries: Float[Tensor, "batch queries 3"],
    ) -> Float[Tensor, "batch queries 3"]:
        """Return displacements [m] in the frame in which the observation is aligned."""
        read = sample(volume, in_box(queries, self.config))
        known = torch.cat([read, queries - 0.5], dim=-1)
        return RESIDUAL_M * self.decoder(known)


class ObservedPictures(NamedTuple):
    """The canonicaliser's output for a batch of pictures.

    Attributes:
        points: points of all pictures, as input of the completion.
        seen: points of each picture, in meters.
        alignments: transform of each picture between the world and the canonical frame.
    """

    points: ObservedPoints
    seen: list[SeenPoints]
    alignments: list[Alignment]


@torch.no_grad()
def observe_pictures(
    canonicaliser: Canonicaliser,
    frame: CanonicalFrame,
    depth: Float[Tensor, "batch 1 h w"],
    pixels: Int[Tensor, "pixels 3"],
    points: Float[np.ndarray, "pixels 3"],
) -> ObservedPictures:
    """Return canonical positions of chosen pixels, and each picture's alignment with the world.

    Args:
        depth: input pictures of the networks [m]; 0 is background.
        points: measured position of each pixel [m], world, z up.
    """
    maps = canonicaliser(depth)
    features = canonicaliser.pixel_features(maps, pixels)
    unit, confidence = coordinates(canonicaliser.logits(maps, pixels), canonicaliser.config.window)
    canonical = frame.to_meters(unit.double().cpu().numpy())
    sure = confidence.double().cpu().numpy().prod(axis=1)
    picture = pixels[:, 0].cpu().numpy()
    aligned = np.empty_like(points)
    seen, alignments = [], []
    for number in range(len(depth)):
        own = picture == number
        one = SeenPoints(points[own], canonical[own], sure[own])
        alignment = align(one.points, one.canonical, one.confidence)
        aligned[own] = alignment.to_canonical(one.points)
        seen.append(one)
        alignments.append(alignment)
    of_batch = ObservedPoints(
        features=features,
        unit=unit,
        confidence=confidence,
        aligned=torch.from_numpy(aligned).to(unit) * frame.scale,
        image=pixels[:, 0],
        images=len(depth),
    )
    return ObservedPictures(of_batch, seen, alignments)


def _double(inputs: int, middle: int, outputs: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for a, b in ((inputs, middle), (middle, outputs)):
        groups = _GROUPS if a % _GROUPS == 0 else 1
        layers += [nn.GroupNorm(groups, a), nn.Conv3d(a, b, 3, padding=1, bias=False), nn.ReLU()]
    return nn.Sequential(*layers)
