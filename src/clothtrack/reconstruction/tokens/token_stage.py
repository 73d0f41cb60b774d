"""What the token network learns: names of pixels, places of tokens, how sure it is of them.

Which of a garment's look-alike labellings is true cannot be seen (`GarmentTokens.labellings`). The
loss of a picture is a soft minimum over them, which hardens while training goes on; at first the
labelling that lies most as the flat garment does is asked for, so that names settle at all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from clothtrack.reconstruction.tokens.token_network import (
    TokenInput,
    TokenNetwork,
    TokenNetworkConfig,
)
from clothtrack.reconstruction.training.training_loop import Stage

PLACE_WEIGHT, SPREAD_WEIGHT, EDGE_WEIGHT = 10.0, 0.1, 2.0
"""Weights of the loss beside 1 for names [nat]: places and edges are in parts of the garment."""

CONVENTION_EXAMPLES, HARDENING_EXAMPLES = 6_000, 12_000
"""Examples for which one labelling is asked for by convention, and after which the minimum over
labellings is as hard as it gets."""

CONVENTION = 20.0
SOFTEST, HARDEST = 0.5, 0.02
"""Temperature of the minimum at the beginning and at the end [nat]."""

LOG_SPREADS = (-6.0, 1.0)
"""Least and largest logarithm of a spread, in parts of the garment."""


@dataclass(frozen=True, eq=False)
class TokenExample:
    """A picture of a garment, and where every token is; lengths in parts of the garment's size.

    Attributes:
        height, distance, features, pixels: as in `TokenInput`.
        pixel_tokens, pixel_shares: the name of each pixel: tokens around what it shows.
        places: of the tokens, in the picture's frame.
        labellings, is_labelling, neighbours: of the garment (`GarmentTokens`).
        conventional: how much each labelling lies as the flat garment does.
        size_m: the unit of length [m].
        weight: how much the label is worth, 0 to 1.
    """

    height: Float[np.ndarray, "rows columns"]
    distance: float
    features: Float[np.ndarray, "tokens features"]
    pixels: Int[np.ndarray, "asked 2"]
    pixel_tokens: Int[np.ndarray, "asked shares"]
    pixel_shares: Float[np.ndarray, "asked shares"]
    places: Float[np.ndarray, "tokens 3"]
    labellings: Int[np.ndarray, "labellings tokens"]
    is_labelling: Bool[np.ndarray, " labellings"]
    neighbours: Int[np.ndarray, "tokens neighbours"]
    conventional: Float[np.ndarray, " labellings"]
    size_m: float
    weight: float = 1.0


_WHOLE = ("pixels", "pixel_tokens", "labellings", "neighbours")
_BOOLEAN = ("is_labelling",)


@dataclass(frozen=True, eq=False)
class TokenBatch:
    """Examples, stacked: the fields of `TokenExample`."""

    height: Tensor
    distance: Tensor
    features: Tensor
    pixels: Tensor
    pixel_tokens: Tensor
    pixel_shares: Tensor
    places: Tensor
    labellings: Tensor
    is_labelling: Tensor
    neighbours: Tensor
    conventional: Tensor
    size_m: Tensor
    weight: Tensor

    def to(self, device: str) -> "TokenBatch":
        """The same on another device."""
        return TokenBatch(**{one.name: getattr(self, one.name).to(device) for one in fields(self)})

    @property
    def asked(self) -> TokenInput:
        """What the network is asked."""
        return TokenInput(self.height, self.distance, self.features, self.pixels)


def collate_tokens(examples: Sequence[TokenExample]) -> TokenBatch:
    """Examples as one batch."""
    stacked = {}
    for one in fields(TokenExample):
        values = np.stack([np.asarray(getattr(example, one.name)) for example in examples])
        kind = torch.long if one.name in _WHOLE else torch.float32
        kind = torch.bool if one.name in _BOOLEAN else kind
        stacked[one.name] = torch.from_numpy(np.ascontiguousarray(values)).to(kind)
    return TokenBatch(**stacked)


class TokenStage(Stage):
    """Training of the token network.

    Args:
        model: is trained.
    """

    name = "tokens"
    score = "place_error"
    unit = "of the garment's side"
    kind = "any"

    def __init__(self, model: TokenNetwork) -> None:
        super().__init__()
        self.network: TokenNetworkConfig = model.config
        self.model = model
        self.trained = nn.ModuleDict({"tokens": model})

    def forward(self, batch: TokenBatch) -> Mapping[str, Tensor]:
        """The loss of a batch and its parts."""
        done = int(self.model.examples)
        self.model.examples.add_(len(batch.height))
        parts = _parts(*self.model(batch.asked), batch)
        each = parts.names + PLACE_WEIGHT * parts.places + EDGE_WEIGHT * parts.edges
        soft = max(0.0, 1.0 - done / HARDENING_EXAMPLES)
        score = -each.detach() / (HARDEST + (SOFTEST - HARDEST) * soft)
        if done < CONVENTION_EXAMPLES:
            shown = batch.conventional.masked_fill(~batch.is_labelling, -torch.inf).argmax(1)
            score = score + CONVENTION * functional.one_hot(shown, score.shape[1]) / HARDEST
        share = score.masked_fill(~batch.is_labelling, -torch.inf).softmax(1)
        whole = ((each + SPREAD_WEIGHT * parts.spreads) * share).sum(1)
        loss = (batch.weight * whole).sum() / batch.weight.sum().clamp(min=1e-12)
        best = parts.best(batch)
        return {
            "loss": loss,
            "names": parts.names.gather(1, best).mean(),
            "places": parts.places.gather(1, best).mean(),
            "edges": parts.edges.gather(1, best).mean(),
        }

    def measure(self, batch: TokenBatch) -> Mapping[str, Tensor]:
        """Errors up to look-alike labelling: places in parts of the garment and in mm, names."""
        parts = _parts(*self.model(batch.asked), batch)
        best = parts.best(batch)
        place = parts.places.gather(1, best)[:, 0]
        return {
            "place_error": place,
            "place_error_mm": 1e3 * batch.size_m * place,
            "name_loss": parts.names.gather(1, best)[:, 0],
        }


@dataclass(frozen=True, eq=False)
class _Parts:
    """Losses per picture and labelling."""

    names: Float[Tensor, "batch labellings"]
    places: Float[Tensor, "batch labellings"]
    spreads: Float[Tensor, "batch labellings"]
    edges: Float[Tensor, "batch labellings"]

    def best(self, batch: TokenBatch) -> Int[Tensor, "batch 1"]:
        """The labelling that fits best."""
        each = self.names + PLACE_WEIGHT * self.places
        return each.detach().masked_fill(~batch.is_labelling, torch.inf).argmin(1)[:, None]


def _parts(logits: Tensor, place: Tensor, batch: TokenBatch) -> _Parts:
    log_names = logits.log_softmax(-1)
    names, places, spreads, edges = [], [], [], []
    near = batch.neighbours
    for number in range(batch.labellings.shape[1]):
        if not bool(batch.is_labelling[:, number].any()):
            for row in (names, places, spreads, edges):
                row.append(torch.zeros_like(batch.distance))
            continue
        # What is token i is called name[i]: its pixels are, and the token of that name lies there.
        name = batch.labellings[:, number]
        called = name.gather(1, batch.pixel_tokens.flatten(1)).view_as(batch.pixel_tokens)
        loss = -(log_names.gather(-1, called) * batch.pixel_shares).sum(-1)
        names.append(loss.sum(-1) / batch.pixel_shares.sum((1, 2)).clamp(min=1e-6))
        guess = place.gather(1, name[..., None].expand(-1, -1, 5))
        gap = guess[..., :3] - batch.places
        places.append(gap.square().sum(-1).add(1e-6).sqrt().mean(-1))
        # The mean learns by distance, the measure itself; the spread by Laplace's likelihood.
        off, spread = gap.detach().abs(), guess[..., 3:].clamp(*LOG_SPREADS)
        level = off[..., :2].sum(-1) * (-spread[..., 0]).exp() + 2.0 * spread[..., 0]
        height = off[..., 2] * (-spread[..., 1]).exp() + spread[..., 1]
        spreads.append((level + height).mean(-1))
        edges.append(
            (_lengths(guess[..., :3], near) - _lengths(batch.places, near)).abs().mean((1, 2))
        )
    return _Parts(*(torch.stack(rows, 1) for rows in (names, places, spreads, edges)))


def _lengths(places: Tensor, near: Tensor) -> Tensor:
    """Distances of tokens from their nearest neighbours."""
    count = 5
    index = near[..., 1:count].flatten(1)[..., None].expand(-1, -1, 3)
    others = places.gather(1, index).view(*places.shape[:2], count - 1, 3)
    return (others - places[:, :, None]).square().sum(-1).add(1e-8).sqrt()
