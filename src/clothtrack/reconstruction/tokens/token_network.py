"""The token network: tokens of the garment and of its picture attend to one another.

One network serves every garment. The garment is an input, as tokens of the rest mesh, and all
lengths are in units of the garment's longer side. A pixel's correspondence is one joint
distribution over all tokens, so that x and y of its canonical position are consistent. Positions of
the tokens are predicted for hidden parts too. One picture may allow several foldings, so the
positions are a few hypotheses, each with a likelihood.
"""

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Bounds, Checked, Count
from clothtrack.reconstruction.tokens.garment_tokens import FEATURES, TOKENS

_CELL = 8
"""Pixels of the picture per cell of the coarse grid; a cell with cloth is a token."""

_OUT_STRIDE = 2
"""Pixels of the picture per output pixel, along each axis."""

_OCTAVES = 5
"""Number of frequencies that encode coordinates: half a period per garment, and doublings."""

KEY = 64
"""Channels of a pixel's query and of a token's key, whose dot product is the pixel's logit."""

_NOWHERE = -1e4


@dataclass(frozen=True)
class TokenNetworkConfig(Checked):
    """Sizes of the network.

    Attributes:
        width: number of channels of a token.
        layers: number of attention layers.
        heads: number of heads per layer; few and wide ones are much faster on a CPU.
        hypotheses: number of alternative sets of positions for one picture.
        image_size: pixels of the picture along each side.
        field_of_view_deg: field of view of the picture's virtual camera [deg].
        view_margin: free space around the cloth, over its extent.
        least_view_m: minimum extent that the picture shows [m].
    """

    width: Count = 128
    layers: Count = 4
    heads: Count = 2
    hypotheses: Count = 4
    image_size: Annotated[int, Bounds(least=32)] = 128
    field_of_view_deg: float = 45.0
    view_margin: float = 0.05
    least_view_m: float = 0.1

    def __post_init__(self) -> None:
        """Reject sizes that do not divide.

        Raises:
            InvalidConfigError: a field is out of bounds; states the field, its value and the limit.
        """
        super().__post_init__()
        for name, value, part in (
            ("width", self.width, self.heads), ("image_size", self.image_size, _CELL)
        ):  # fmt: skip
            if value % part:
                raise InvalidConfigError(
                    f"network.{name} is {value}; it must be a multiple of {part}"
                )

    @property
    def output_stride(self) -> int:
        """Pixels of the picture per output pixel."""
        return _OUT_STRIDE

    @property
    def output_size(self) -> int:
        """Number of output pixels along each side."""
        return self.image_size // _OUT_STRIDE


@dataclass(frozen=True, eq=False)
class TokenInput:
    """Pictures of garments; all lengths in units of the garment's longer side.

    Attributes:
        height: height above the table; `EMPTY` where no cloth was measured.
        distance: distance of the camera from the table.
        pixels: row and column of each pixel whose correspondence is requested.
    """

    height: Float[Tensor, "batch rows columns"]
    distance: Float[Tensor, " batch"]
    features: Float[Tensor, "batch tokens features"]
    pixels: Int[Tensor, "batch asked 2"]


EMPTY = -10.0
"""Height of a pixel without cloth."""


class TokenOutput(NamedTuple):
    """Answers to a batch of pictures.

    Attributes:
        names: logits of the pixels' correspondences over the tokens.
        places: x, y, z and two log spreads of each token under each hypothesis, in units of the
            garment's longer side and in the picture's frame: x to the right, y up, z up from the
            table, the origin on the table below the camera.
    """

    names: Float[Tensor, "batch asked tokens"]
    places: Float[Tensor, "batch hypotheses tokens 5"]
    choice: Float[Tensor, "batch hypotheses"]


class TokenNetwork(nn.Module):
    """Network that predicts correspondences of pixels and positions of tokens.

    Attributes:
        examples: number of examples it was trained with.
    """

    ticks: Tensor
    examples: Tensor

    def __init__(self, config: TokenNetworkConfig) -> None:
        """Initialize an untrained network."""
        super().__init__()
        self.config = config
        width = config.width
        self.stem = nn.Sequential(
            _convolution(5, 32, 2), nn.ReLU(), _convolution(32, 32), nn.ReLU()
        )
        self.down = nn.ModuleList(
            [_Residual(32, 64, 2), _Residual(64, width, 2), _Residual(width, width, 1)]
        )
        self.cell = nn.Linear(2 * (2 * _OCTAVES + 1) + 1, width)
        self.garment = nn.Sequential(
            nn.Linear(FEATURES - 4 + 4 * (2 * _OCTAVES + 1), width),
            nn.GELU(),
            nn.Linear(width, width),
        )
        self.layers = nn.ModuleList(_Layer(width, config.heads) for _ in range(config.layers))
        self.norm = nn.LayerNorm(width)
        self.back = nn.Conv2d(width, 64, 1)
        self.up = nn.Sequential(_convolution(128, 64), nn.ReLU())
        self.pixel = nn.Sequential(nn.Linear(96, 128), nn.ReLU(), nn.Linear(128, KEY))
        self.key = nn.Linear(width, KEY)
        self.place = nn.Sequential(
            nn.Linear(width, width), nn.GELU(), nn.Linear(width, 5 * config.hypotheses)
        )
        self.choice = nn.Linear(width, config.hypotheses) if config.hypotheses > 1 else None
        self.sharpness = nn.Parameter(torch.zeros(()))
        size = config.image_size
        ticks = (torch.arange(size) - 0.5 * (size - 1)) / (0.5 * size)
        ticks = ticks * math.tan(math.radians(config.field_of_view_deg) / 2.0)
        self.register_buffer("ticks", ticks, persistent=False)
        # Saved with the weights, so that a resumed training continues its schedule.
        self.register_buffer("examples", torch.zeros((), dtype=torch.long))

    def forward(self, asked: TokenInput) -> TokenOutput:
        """Return correspondences of pixels, hypotheses of token positions, and likelihoods."""
        batch, cells = len(asked.height), self.config.image_size // _CELL
        cloth = (asked.height > 0.5 * EMPTY).float()
        fine = self.stem(self._channels(asked, cloth).contiguous(memory_format=torch.channels_last))
        middle = self.down[0](fine)
        coarse = self.down[2](self.down[1](middle))
        filled = functional.max_pool2d(cloth[:, None], _CELL).flatten(1) > 0
        seen = coarse.flatten(2).transpose(1, 2) + self.cell(self._cell_places(asked))
        # Drop empty cells: sort cells with cloth first and truncate to the fullest picture.
        order = torch.argsort(filled.float(), dim=1, descending=True, stable=True)
        # Round up to a multiple of 32, because each new shape needs its own kernels and memory.
        fullest = -(-int(filled.sum(1).max()) // 32) * 32
        order = order[:, :fullest]
        index = order[..., None].expand(-1, -1, seen.shape[-1])
        valid = filled.gather(1, order)
        garment = self.garment(self._told(asked.features))
        tokens = torch.cat([garment.to(seen.dtype), seen.gather(1, index)], 1)
        bias = self._bias(valid, tokens)
        for layer in self.layers:
            tokens = layer(tokens, bias)
        tokens = self.norm(tokens)
        template, picture = tokens[:, :TOKENS], tokens[:, TOKENS:] * valid[..., None]
        grid = torch.zeros_like(seen, dtype=picture.dtype).scatter(1, index, picture)
        grid = self.back(grid.transpose(1, 2).reshape(batch, -1, cells, cells))
        grid = functional.interpolate(grid, scale_factor=2, mode="bilinear")
        wide = functional.interpolate(
            self.up(torch.cat([grid, middle], 1)), scale_factor=2, mode="bilinear"
        )
        rows, columns = asked.pixels.unbind(-1)
        image = torch.arange(batch, device=rows.device)[:, None].expand_as(rows)
        at = [part.permute(0, 2, 3, 1)[image, rows, columns] for part in (wide, fine)]
        names = self.pixel(torch.cat(at, -1))
        logits = names @ self.key(template).transpose(1, 2) * (self.sharpness.exp() / KEY**0.5)
        return TokenOutput(logits.float(), *self._hypotheses(template))

    def _hypotheses(
        self, template: Float[Tensor, "batch tokens width"]
    ) -> tuple[Float[Tensor, "batch hypotheses tokens 5"], Float[Tensor, "batch hypotheses"]]:
        """Return the token positions under each hypothesis, and the hypotheses' logits."""
        count = self.config.hypotheses
        places = self.place(template).float()
        places = places.unflatten(-1, (count, 5)).transpose(1, 2)
        if self.choice is None:
            return places, places.new_zeros(len(places), 1)
        return places, self.choice(template.mean(1)).float()

    def _channels(
        self, asked: TokenInput, cloth: Float[Tensor, "batch rows columns"]
    ) -> Float[Tensor, "batch 5 rows columns"]:
        """Return cloth mask, height, height over the mean, x and y, each scaled to about 1."""
        height = asked.height * cloth
        depth = asked.distance[:, None, None] - height
        x, y = self.ticks[None, None, :] * depth, -self.ticks[None, :, None] * depth
        mean = (height.sum((1, 2)) / cloth.sum((1, 2)).clamp(min=1.0))[:, None, None]
        rows = [cloth, height * 5.0, (height - mean) * 15.0, x * 2.0, y * 2.0]
        return torch.stack([rows[0], *(cloth * row for row in rows[1:])], 1)

    def _cell_places(self, asked: TokenInput) -> Float[Tensor, "batch cells told"]:
        """Return the encoded cell centers on the table, and the camera's distance from it."""
        middles = self.ticks.view(-1, _CELL).mean(1)
        across = torch.broadcast_tensors(middles[None, :], -middles[:, None])
        far = asked.distance[:, None, None]
        at = torch.stack(across, -1).view(1, -1, 2) * far
        return torch.cat([_waves(at), far.expand(-1, at.shape[1], 1)], -1)

    def _told(self, features: Float[Tensor, "batch tokens features"]) -> Tensor:
        """Return the token features, with sines and cosines of their coordinates."""
        metric, between, relative = features[..., :2], features[..., 2:5], features[..., 5:]
        return torch.cat([_waves(metric), _waves(relative), between], -1)

    def _bias(
        self, valid: Bool[Tensor, "batch cells"], tokens: Float[Tensor, "batch all width"]
    ) -> Float[Tensor, "batch 1 1 all"]:
        """Return the attention bias that masks padding."""
        of_garment = valid.new_ones(len(valid), TOKENS)
        mask = torch.cat([of_garment, valid], 1)[:, None, None, :]
        return torch.zeros(mask.shape, dtype=tokens.dtype, device=mask.device).masked_fill(
            ~mask, _NOWHERE
        )


class _Residual(nn.Module):
    """Two convolutions and a shortcut."""

    def __init__(self, inward: int, outward: int, stride: int) -> None:
        super().__init__()
        self.first = _convolution(inward, outward, stride)
        self.second = _convolution(outward, outward)
        same = inward == outward and stride == 1
        self.shortcut = nn.Identity() if same else _convolution(inward, outward, stride, size=1)

    def forward(self, picture: Tensor) -> Tensor:
        """Return the feature map, at half the resolution if the stride is 2."""
        return functional.relu(
            self.second(functional.relu(self.first(picture))) + self.shortcut(picture)
        )


class _Layer(nn.Module):
    """Self-attention of all tokens, of garment and picture, and a perceptron."""

    def __init__(self, width: int, heads: int, growth: int = 3) -> None:
        super().__init__()
        self.heads = heads
        self.before, self.after = nn.LayerNorm(width), nn.LayerNorm(width)
        self.split, self.join = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.perceptron = nn.Sequential(
            nn.Linear(width, growth * width), nn.GELU(), nn.Linear(growth * width, width)
        )

    def forward(self, tokens: Tensor, bias: Tensor) -> Tensor:
        """Return the tokens after attention and perceptron."""
        batch, count, width = tokens.shape
        parts = self.split(self.before(tokens)).view(batch, count, 3, self.heads, -1)
        query, key, value = parts.permute(2, 0, 3, 1, 4)
        # Not fused: on a CPU the fused kernel takes 2.6 times as long in bfloat16, mostly backward.
        scores = (query * (width // self.heads) ** -0.5) @ key.transpose(-1, -2)
        looked = (scores + bias).softmax(-1) @ value
        tokens = tokens + self.join(looked.transpose(1, 2).reshape(batch, count, width))
        return tokens + self.perceptron(self.after(tokens))


def _convolution(inward: int, outward: int, stride: int = 1, *, size: int = 3) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inward, outward, size, stride, size // 2, bias=False), nn.BatchNorm2d(outward)
    )


def _waves(places: Float[Tensor, "*batch axes"]) -> Float[Tensor, "*batch waves"]:
    """Return coordinates with their sines and cosines."""
    angles = torch.cat([places * (math.pi * 2.0**octave) for octave in range(_OCTAVES)], -1)
    return torch.cat([places, angles.sin(), angles.cos()], -1)
