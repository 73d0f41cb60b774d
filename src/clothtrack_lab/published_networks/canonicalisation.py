"""Canonicalisation: the material point shown by each pixel of cloth.

Each canonical axis is divided into bins, and the network classifies (GarmentNets, arXiv 2104.05177,
section 3.2). If several answers fit, a distribution keeps them apart, whereas regression would
average them.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from clothtrack_lab.published_networks.network_config import NetworkConfig

_RELIEF_M = 0.03
"""Height above the cloth's mean [m] that is scaled to 1 in the network's input."""


def _convolution(inputs: int, outputs: int, *, size: int = 3, stride: int = 1) -> nn.Sequential:
    """Return a size-preserving convolution (except for its stride) and a batch norm."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, size, stride, padding=size // 2, bias=False),
        nn.BatchNorm2d(outputs),
    )


class _ResidualBlock(nn.Module):
    """ReLU(x + F(x)), F two 3x3 convolutions."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.residual = nn.Sequential(
            _convolution(inputs, outputs), nn.ReLU(), _convolution(outputs, outputs)
        )
        same = inputs == outputs
        self.shortcut = nn.Identity() if same else _convolution(inputs, outputs, size=1)

    def forward(
        self, picture: Float[Tensor, "batch inputs h w"]
    ) -> Float[Tensor, "batch outputs h w"]:
        """Return the block's output at the resolution of its input."""
        return functional.relu(self.shortcut(picture) + self.residual(picture))


class _UNet(nn.Module):
    """An encoder and decoder with skip connections; features have half the picture's resolution.

    Args:
        widths: channels at each resolution, halved from one to the next.
    """

    def __init__(self, inputs: int, widths: tuple[int, ...], outputs: int) -> None:
        super().__init__()
        self.stem = nn.Sequential(_convolution(inputs, widths[0], stride=2), nn.ReLU())
        befores = (widths[0], *widths[:-1])
        self.down = nn.ModuleList(
            _ResidualBlock(before, width) for before, width in zip(befores, widths, strict=True)
        )
        self.up = nn.ModuleList()
        below = widths[-1]
        for width in reversed(widths[:-1]):
            above = max(width, outputs)
            self.up.append(nn.Sequential(_convolution(below + width, above), nn.ReLU()))
            below = above
        last_is_fit = below == outputs
        self.last = (
            nn.Identity()
            if last_is_fit
            else nn.Sequential(_convolution(below, outputs, size=1), nn.ReLU())
        )
        self.channels = outputs

    def forward(
        self, picture: Float[Tensor, "batch inputs h w"]
    ) -> Float[Tensor, "batch channels h2 w2"]:
        """Return the features."""
        x = self.stem(picture)
        skips = []
        for level, block in enumerate(self.down):
            x = block(x if level == 0 else functional.max_pool2d(x, 2))
            skips.append(x)
        for block, skip in zip(self.up, reversed(skips[:-1]), strict=True):
            x = functional.interpolate(x, size=skip.shape[-2:], mode="nearest")
            x = block(torch.cat([x, skip], dim=1))
        return self.last(x)


class Canonicaliser(nn.Module):
    """A network from a depth picture to a distribution over bins per canonical axis.

    Attributes:
        channels: channels of a pixel's feature, which is also an input of the completion.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = _UNet(3, config.widths, config.decoder_width)
        self.channels = self.encoder.channels
        self.bins = nn.Linear(self.channels, 3 * config.bins)

    def forward(self, depth: Float[Tensor, "batch 1 h w"]) -> Float[Tensor, "batch channels h2 w2"]:
        """Return features of the picture, from depth [m] in which 0 is background."""
        return self.encoder(relief(depth))

    def logits(
        self, features: Float[Tensor, "batch channels h2 w2"], pixels: Int[Tensor, "pixels 3"]
    ) -> Float[Tensor, "pixels 3 bins"]:
        """Return the logits of the bins of each axis, at these pixels only.

        Other pixels are not computed, because most of a picture is table.
        """
        chosen = self.pixel_features(features, pixels)
        return self.bins(chosen).reshape(len(pixels), 3, self.config.bins)

    def pixel_features(
        self, features: Float[Tensor, "batch channels h2 w2"], pixels: Int[Tensor, "pixels 3"]
    ) -> Float[Tensor, "pixels channels"]:
        """Return the feature of each pixel."""
        picture, row, column = pixels.unbind(dim=1)
        return features.permute(0, 2, 3, 1)[picture, row, column]


def relief(depth: Float[Tensor, "batch 1 h w"]) -> Float[Tensor, "batch 3 h w"]:
    """Return silhouette, height above the cloth's mean (in `_RELIEF_M`), and that mean depth [m].

    An untrained network cannot resolve wrinkles of millimeters at a distance of a meter. The mean
    depth is kept because it determines the size of the cloth.
    """
    cloth = (depth > 0).to(depth.dtype)
    count = cloth.sum(dim=(1, 2, 3), keepdim=True).clamp(min=1.0)
    mean = depth.sum(dim=(1, 2, 3), keepdim=True) / count
    return torch.cat([cloth, cloth * (mean - depth) / _RELIEF_M, cloth * mean], dim=1)


def coordinates(
    logits: Float[Tensor, "pixels 3 bins"], window: int = 2
) -> tuple[Float[Tensor, "pixels 3"], Float[Tensor, "pixels 3"]]:
    """Return canonical coordinates in the unit cube, and the network's confidence.

    The coordinate is the mean of the bins around the best one, weighted by their probability. It
    avoids the half-bin error of the best bin alone and ignores a competing answer elsewhere.
    """
    count = logits.shape[-1]
    probability = logits.float().softmax(dim=-1)
    offsets = torch.arange(-window, window + 1, device=logits.device)
    near = probability.argmax(dim=-1, keepdim=True) + offsets
    inside = (near >= 0) & (near < count)
    near = near.clamp(0, count - 1)
    share = probability.gather(-1, near) * inside
    confidence = share.sum(dim=-1)
    return (share * (near + 0.5)).sum(dim=-1) / (count * confidence), confidence


def bin_of(unit: Float[Tensor, "*points 3"], bins: int) -> Int[Tensor, "*points 3"]:
    """Return the bin of a coordinate in the unit cube."""
    return (unit * bins).floor().long().clamp(0, bins - 1)


def relabeled(
    unit: Float[Tensor, "points 3"], signs: Float[Tensor, " 3"]
) -> Float[Tensor, "points 3"]:
    """Return coordinates in the unit cube after a symmetry of the garment."""
    return 0.5 + (unit - 0.5) * signs


def symmetry_losses(
    logits: Float[Tensor, "pixels 3 bins"],
    targets: Float[Tensor, "pixels 3"],
    image_of_pixel: Int[Tensor, " pixels"],
    symmetries: Float[Tensor, "symmetries 3"],
    images: int,
) -> Float[Tensor, "images symmetries"]:
    """Return the cross entropy of each picture for each symmetry of the garment [nat].

    It is the mean over axes and the picture's pixels, and 0 for a picture without pixels.
    """
    log_probability = logits.float().log_softmax(dim=-1)
    sums = log_probability.new_zeros(images, len(symmetries))
    for index, signs in enumerate(symmetries):
        right = bin_of(relabeled(targets, signs), logits.shape[-1])
        of_pixel = -log_probability.gather(-1, right[..., None])[..., 0].mean(dim=-1)
        sums[:, index] = sums[:, index].index_add(0, image_of_pixel, of_pixel)
    pixels = torch.bincount(image_of_pixel, minlength=images).clamp(min=1)
    return sums / pixels[:, None]


def canonical_loss(
    logits: Float[Tensor, "pixels 3 bins"],
    targets: Float[Tensor, "pixels 3"],
    image_of_pixel: Int[Tensor, " pixels"],
    symmetries: Float[Tensor, "symmetries 3"],
    images: int,
) -> Float[Tensor, ""]:
    """Return the cross entropy, for each picture under its best symmetry [nat].

    Which symmetry is true cannot be seen, so any of them is right. It must be the same for the
    whole picture, because otherwise the map would tear.
    """
    losses = symmetry_losses(logits, targets, image_of_pixel, symmetries, images)
    shown = torch.bincount(image_of_pixel, minlength=images) > 0
    return (losses.amin(dim=1) * shown).sum() / shown.sum().clamp(min=1)
