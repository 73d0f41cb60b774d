"""The loss of the token network: correspondences of pixels, positions of tokens, and spreads.

A picture cannot distinguish the symmetries of a garment (`GarmentTokens.labelings`). The loss of a
picture is therefore a soft minimum over them, which hardens during training. At first the symmetry
closest to the flat garment's pose is the target, because otherwise correspondences do not converge.

Of several hypotheses of the positions only the nearest learns ("winner takes all"; A.
Guzman-Rivera, D. Batra, P. Kohli, 2012), and its likelihood rises. A small share of the loss goes
to the others, so that none stops learning (C. Rupprecht et al., 2017,
doi:10.1109/ICCV.2017.388).
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
    TokenOutput,
)
from clothtrack.reconstruction.training.stage import Stage

PLACE_WEIGHT, SPREAD_WEIGHT, EDGE_WEIGHT = 10.0, 0.1, 2.0
"""Loss weights relative to 1 for correspondences [nat]; positions and edges are in units of the
garment's size."""

CONVENTION_EXAMPLES, HARDENING_EXAMPLES = 6_000, 12_000
"""Number of examples with the symmetry fixed by convention, and number of examples after which the
minimum over symmetries has its final hardness."""

_OTHERS = 0.08
"""Total share of the position loss for the hypotheses that are not the nearest."""

_CHOICE_WEIGHT = 0.2
"""Weight of the cross entropy of the hypotheses' likelihoods [nat]."""

_CONVENTION = 20.0
SOFTEST, HARDEST = 0.5, 0.02
"""Temperature of the minimum at the beginning and at the end [nat]."""

LOG_SPREADS = (-6.0, 1.0)
"""Least and largest logarithm of a spread in units of the garment's size."""


@dataclass(frozen=True, eq=False)
class TokenExample:
    """A picture of a garment with token positions; lengths in units of the garment's size.

    Attributes:
        height, distance, features, pixels: as in `TokenInput`.
        pixel_tokens, pixel_shares: correspondence of each pixel: tokens around its point, weights.
        places: positions of the tokens in the picture's frame.
        conventional: agreement of the cloth with the flat garment's pose under each symmetry.
        size_m: unit of length [m].
        weight: 0 if the picture shows no cloth, otherwise 1.
    """

    height: Float[np.ndarray, "rows columns"]
    distance: float
    features: Float[np.ndarray, "tokens features"]
    pixels: Int[np.ndarray, "asked 2"]
    pixel_tokens: Int[np.ndarray, "asked shares"]
    pixel_shares: Float[np.ndarray, "asked shares"]
    places: Float[np.ndarray, "tokens 3"]
    labelings: Int[np.ndarray, "labelings tokens"]
    is_labeling: Bool[np.ndarray, " labelings"]
    neighbors: Int[np.ndarray, "tokens neighbors"]
    conventional: Float[np.ndarray, " labelings"]
    size_m: float
    weight: float = 1.0


_WHOLE = ("pixels", "pixel_tokens", "labelings", "neighbors")
_BOOLEAN = ("is_labeling",)


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
    labelings: Tensor
    is_labeling: Tensor
    neighbors: Tensor
    conventional: Tensor
    size_m: Tensor
    weight: Tensor

    def to(self, device: str) -> "TokenBatch":
        """Return the batch on another device."""
        return TokenBatch(**{one.name: getattr(self, one.name).to(device) for one in fields(self)})

    @property
    def asked(self) -> TokenInput:
        """Input of the network."""
        return TokenInput(self.height, self.distance, self.features, self.pixels)


def collate_tokens(examples: Sequence[TokenExample]) -> TokenBatch:
    """Return the examples as one batch."""
    stacked = {}
    for one in fields(TokenExample):
        values = np.stack([np.asarray(getattr(example, one.name)) for example in examples])
        kind = torch.long if one.name in _WHOLE else torch.float32
        kind = torch.bool if one.name in _BOOLEAN else kind
        stacked[one.name] = torch.from_numpy(np.ascontiguousarray(values)).to(kind)
    return TokenBatch(**stacked)


class TokenStage(Stage):
    """Training of the token network."""

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
        """Return the loss of a batch and its parts."""
        done = int(self.model.examples)
        self.model.examples.add_(len(batch.height))
        output = self.model(batch.asked)
        parts = _parts(output, batch)
        nearest = parts.of_places.detach().argmin(-1, keepdim=True)
        own = torch.zeros_like(parts.places).scatter(-1, nearest, 1.0)
        count = own.shape[-1]
        taught = (1.0 - _OTHERS) * own + _OTHERS / count if count > 1 else own
        each = parts.names + parts.of_places.gather(-1, nearest)[..., 0]
        soft = max(0.0, 1.0 - done / HARDENING_EXAMPLES)
        score = -each.detach() / (HARDEST + (SOFTEST - HARDEST) * soft)
        if done < CONVENTION_EXAMPLES:
            shown = batch.conventional.masked_fill(~batch.is_labeling, -torch.inf).argmax(1)
            score = score + _CONVENTION * functional.one_hot(shown, score.shape[1]) / HARDEST
        share = score.masked_fill(~batch.is_labeling, -torch.inf).softmax(1)
        placed = ((parts.of_places + SPREAD_WEIGHT * parts.spreads) * taught).sum(-1)
        best = parts.best(batch)
        winner = nearest[..., 0].gather(1, best)[:, 0]
        chosen = functional.cross_entropy(output.choice, winner, reduction="none")
        whole = ((parts.names + placed) * share).sum(1) + _CHOICE_WEIGHT * chosen
        loss = (batch.weight * whole).sum() / batch.weight.sum().clamp(min=1e-12)
        return {
            "loss": loss,
            "names": parts.names.gather(1, best).mean(),
            "places": parts.places.amin(-1).gather(1, best).mean(),
            "edges": parts.edges.gather(-1, nearest)[..., 0].gather(1, best).mean(),
            "choice": chosen.mean(),
        }

    def measure(self, batch: TokenBatch) -> Mapping[str, Tensor]:
        """Return errors up to symmetry, per picture.

        Position errors are those of the likeliest hypothesis, in units of the garment's size and in
        mm, and of the nearest one ("nearest_error"). "edge_ratio" is the length of edges between
        tokens over their true length; it is below 1 when positions shrink towards a mean.
        """
        output = self.model(batch.asked)
        parts = _parts(output, batch)
        likeliest = output.choice.argmax(1)
        index = likeliest[:, None, None].expand(-1, parts.names.shape[1], 1)
        own = parts.at(index)
        best = own.best(batch)
        place = own.places[..., 0].gather(1, best)[:, 0]
        apart = parts.places.amin(-1).masked_fill(~batch.is_labeling, torch.inf)
        near = batch.neighbors
        answer = output.places[torch.arange(len(likeliest), device=place.device), likeliest]
        lengths = _lengths(answer[..., :3], near).mean((1, 2))
        return {
            "place_error": place,
            "place_error_mm": 1e3 * batch.size_m * place,
            "nearest_error": apart.amin(1),
            "name_loss": parts.names.gather(1, best)[:, 0],
            "edge_ratio": lengths / _lengths(batch.places, near).mean((1, 2)).clamp(min=1e-6),
        }


@dataclass(frozen=True, eq=False)
class _Parts:
    """Losses per picture, symmetry and hypothesis; zero for padding rows."""

    names: Float[Tensor, "batch labelings"]
    places: Float[Tensor, "batch labelings hypotheses"]
    spreads: Float[Tensor, "batch labelings hypotheses"]
    edges: Float[Tensor, "batch labelings hypotheses"]

    @property
    def of_places(self) -> Float[Tensor, "batch labelings hypotheses"]:
        """Weighted loss of positions and edges."""
        return PLACE_WEIGHT * self.places + EDGE_WEIGHT * self.edges

    def at(self, index: Int[Tensor, "batch labelings 1"]) -> "_Parts":
        """Return the losses of one hypothesis per picture."""
        rows = (part.gather(-1, index) for part in (self.places, self.spreads, self.edges))
        return _Parts(self.names, *rows)

    def best(self, batch: TokenBatch) -> Int[Tensor, "batch 1"]:
        """Return the symmetry that fits best, each evaluated with its nearest hypothesis."""
        each = self.names + PLACE_WEIGHT * self.places.amin(-1)
        return each.detach().masked_fill(~batch.is_labeling, torch.inf).argmin(1)[:, None]


def _parts(output: TokenOutput, batch: TokenBatch) -> _Parts:
    picture, labeling = batch.is_labeling.nonzero(as_tuple=True)
    # A symmetry relabels token i as name[i]: its pixels should predict name[i], and the prediction
    # for token name[i] should lie at the position of token i.
    name = batch.labelings[picture, labeling]
    shares = batch.pixel_shares[picture]
    called = name.gather(1, batch.pixel_tokens[picture].flatten(1)).view_as(shares)
    loss = -(output.names.log_softmax(-1)[picture].gather(-1, called) * shares).sum((1, 2))
    names = loss / shares.sum((1, 2)).clamp(min=1e-6)
    index = name[:, None, :, None].expand(-1, output.places.shape[1], -1, 5)
    guess = output.places[picture].gather(2, index)
    true, near = batch.places[picture][:, None], batch.neighbors[picture]
    gap = guess[..., :3] - true
    places = gap.square().sum(-1).add(1e-6).sqrt().mean(-1)
    # The position is trained by distance, like the measure; the spread by a Laplace likelihood.
    off, spread = gap.detach().abs(), guess[..., 3:].clamp(*LOG_SPREADS)
    level = off[..., :2].sum(-1) * (-spread[..., 0]).exp() + 2.0 * spread[..., 0]
    height = off[..., 2] * (-spread[..., 1]).exp() + spread[..., 1]
    spreads = (level + height).mean(-1)
    long, wanted = _lengths(guess[..., :3], near[:, None]), _lengths(true, near[:, None])
    edges = (long - wanted).abs().mean((-2, -1))

    def table(values: Tensor) -> Tensor:
        # Padding rows are zero, so that their share of the loss and their gradient are zero too.
        shape = (*batch.is_labeling.shape, *values.shape[1:])
        return values.new_zeros(shape).index_put((picture, labeling), values)

    return _Parts(table(names), table(places), table(spreads), table(edges))


def _lengths(
    places: Float[Tensor, "*batch tokens 3"], near: Int[Tensor, "*around tokens neighbors"]
) -> Float[Tensor, "*batch tokens others"]:
    """Return the distances of tokens from their nearest neighbors."""
    count = 5
    index = near[..., 1:count].flatten(-2)[..., None]
    index = index.expand(*places.shape[:-2], index.shape[-2], 3)
    others = places.gather(-2, index).unflatten(-2, (places.shape[-2], count - 1))
    return (others - places[..., None, :]).square().sum(-1).add(1e-8).sqrt()
