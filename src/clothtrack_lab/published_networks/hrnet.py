"""HRNet: a convolutional encoder that keeps its fine resolution parallel to coarser ones.

Sun et al., "High-resolution representations for labeling pixels and regions" (arXiv 1904.04514),
with the modules that MEDOR (arXiv 2209.03287) uses. Branches exchange features after every module.
The result is all branches, upsampled to the finest resolution.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

_STEM_CHANNELS = 64
MODULES = (1, 4, 3)
"""Number of modules in the stages with two, three and four branches."""

_BLOCKS = 4
"""Number of residual blocks per branch in each module, and in the stage with a single branch."""


def convolution(inputs: int, outputs: int, *, size: int = 3, stride: int = 1) -> nn.Sequential:
    """Return a size-preserving convolution (except for its stride) and a batch norm."""
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, size, stride, padding=size // 2, bias=False),
        nn.BatchNorm2d(outputs),
    )


class ResidualBlock(nn.Module):
    """ReLU(x + F(x)), F two 3x3 convolutions, or 1x1, 3x3, 1x1 with a narrow middle.

    Args:
        middle: channels of the narrow middle; None makes the block of two convolutions.
    """

    def __init__(self, inputs: int, outputs: int, middle: int | None = None) -> None:
        super().__init__()
        if middle is None:
            layers = [convolution(inputs, outputs), nn.ReLU(), convolution(outputs, outputs)]
        else:
            layers = [convolution(inputs, middle, size=1), nn.ReLU()]
            layers += [convolution(middle, middle), nn.ReLU()]
            layers += [convolution(middle, outputs, size=1)]
        self.residual = nn.Sequential(*layers)
        same = inputs == outputs
        self.shortcut = nn.Identity() if same else convolution(inputs, outputs, size=1)

    def forward(
        self, picture: Float[Tensor, "batch inputs h w"]
    ) -> Float[Tensor, "batch outputs h w"]:
        """Return the block's output at the resolution of its input."""
        return functional.relu(self.shortcut(picture) + self.residual(picture))


class HRNet(nn.Module):
    """The encoder: a depth picture in, a feature per 4 x 4 pixels out.

    Args:
        widths: channels of the four branches, from fine to coarse.
    """

    def __init__(self, inputs: int, widths: Sequence[int]) -> None:
        super().__init__()
        stem = _STEM_CHANNELS
        self.stem = nn.Sequential(
            convolution(inputs, stem, stride=2),
            nn.ReLU(),
            convolution(stem, stem, stride=2),
            nn.ReLU(),
        )
        wide = [stem, *[4 * stem] * _BLOCKS]
        self.first = nn.Sequential(*[ResidualBlock(a, b, stem) for a, b in pairwise(wide)])
        self.stages = nn.ModuleList()
        previous = [4 * stem]
        for branches, modules in enumerate(MODULES, start=2):
            current = list(widths[:branches])
            enter = _Transition(previous, current)
            self.stages.append(nn.Sequential(enter, *[_Exchange(current) for _ in range(modules)]))
            previous = current
        self.channels = sum(widths)

    def forward(
        self, picture: Float[Tensor, "batch inputs h w"]
    ) -> Float[Tensor, "batch channels h4 w4"]:
        """Return all branches at the resolution of the finest one."""
        branches = [self.first(self.stem(picture))]
        for stage in self.stages:
            branches = stage(branches)
        size = branches[0].shape[-2:]
        finest = [_resized(branch, size) for branch in branches]
        return torch.cat(finest, dim=1)


class _Transition(nn.Module):
    """A layer that sets the branches' channels and adds one at half the coarsest resolution."""

    def __init__(self, previous: list[int], current: list[int]) -> None:
        super().__init__()
        kept = zip(previous, current, strict=False)
        same = [
            nn.Identity() if a == b else nn.Sequential(convolution(a, b), nn.ReLU())
            for a, b in kept
        ]
        new = nn.Sequential(convolution(previous[-1], current[-1], stride=2), nn.ReLU())
        self.paths = nn.ModuleList([*same, new])

    def forward(self, branches: list[Tensor]) -> list[Tensor]:
        """Return one branch more than the input has."""
        sources = [*branches, branches[-1]]
        return [path(source) for path, source in zip(self.paths, sources, strict=True)]


class _Exchange(nn.Module):
    """Residual blocks in every branch, followed by a sum over all branches in each."""

    def __init__(self, widths: list[int]) -> None:
        super().__init__()
        self.branches = nn.ModuleList(
            nn.Sequential(*[ResidualBlock(width, width) for _ in range(_BLOCKS)])
            for width in widths
        )
        self.paths = nn.ModuleList(
            nn.ModuleList(_path(widths, source, target) for source in range(len(widths)))
            for target in range(len(widths))
        )

    def forward(self, branches: list[Tensor]) -> list[Tensor]:
        """Return as many branches as the input has."""
        own = [one(branch) for one, branch in zip(self.branches, branches, strict=True)]
        mixed = []
        for target, paths in enumerate(self.paths):
            size = own[target].shape[-2:]
            text = [_resized(path(x), size) for path, x in zip(paths, own, strict=True)]
            mixed.append(functional.relu(torch.stack(text).sum(dim=0)))
        return mixed


def _path(widths: list[int], source: int, target: int) -> nn.Module:
    """Return the map between two branches: strided convolutions down, a 1x1 convolution up."""
    if source == target:
        return nn.Identity()
    if source > target:
        return convolution(widths[source], widths[target], size=1)
    steps: list[nn.Module] = []
    for step in range(source, target):
        last = step == target - 1
        steps.append(convolution(widths[source], widths[target if last else source], stride=2))
        if not last:
            steps.append(nn.ReLU())
    return nn.Sequential(*steps)


def _resized(picture: Tensor, size: torch.Size) -> Tensor:
    if picture.shape[-2:] == size:
        return picture
    return functional.interpolate(picture, size=size, mode="bilinear", align_corners=False)
