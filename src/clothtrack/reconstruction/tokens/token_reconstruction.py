"""The token network's answers for one garment in one depth picture.

The network is given the picture in its eight quarter turns and mirror images. Answers that agree
up to symmetry are merged, each weighted by its own spread. `reconstruction.search` compares rival
answers with the picture and selects one.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from clothtrack.errors import InvalidResultError
from clothtrack.geometry.camera import about_vertical
from clothtrack.reconstruction.data.view import CroppedView, cloth_pixels, crop, points_of
from clothtrack.reconstruction.depth_input import DepthInput
from clothtrack.reconstruction.isometric_fit import Guide
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.reconstruction.tokens.garment_tokens import GarmentTokens
from clothtrack.reconstruction.tokens.token_examples import seen_by_network
from clothtrack.reconstruction.tokens.token_learning import PREFIX, require_tokens
from clothtrack.reconstruction.tokens.token_network import (
    TokenInput,
    TokenNetwork,
    TokenNetworkConfig,
)
from clothtrack.reconstruction.tokens.token_stage import LOG_SPREADS
from clothtrack.reconstruction.training.checkpoint import Weights, load_weights

VIEWS = 8
"""Number of quarter turns and mirror images of a picture."""

_ALIKE = 0.1
"""Mean token distance, over the garment's size, below which hypotheses agree."""

_LEAST_LIKELY = 0.1
"""Hypotheses less likely than this in their view do not start a set of agreeing hypotheses."""

_MOST_PARTIES = 8
"""Maximum number of rival answers for one picture."""


@dataclass(frozen=True, eq=False)
class Look:
    """One picture as the network sees it, for any garment.

    Attributes:
        view: picture of the cloth from straight above.
        pixels: row and column of each pixel of cloth in the canonical picture.
        points: measured point of each pixel [m], world.
        table_m: height of the table in the world [m].
    """

    view: CroppedView
    pixels: Int[np.ndarray, "points 2"]
    points: Float[np.ndarray, "points 3"]
    table_m: float


@dataclass(frozen=True, eq=False)
class TokenAnswer:
    """The network's prediction for one picture of one garment.

    Attributes:
        seen: measured points, their canonical positions [m] and the probability near those.
        places: token positions in the world [m].
        spreads: horizontal and vertical mean deviation of each position [m].
        pixels: row and column of each point in the canonical picture.
    """

    seen: SeenPoints
    places: Float[np.ndarray, "tokens 3"]
    spreads: Float[np.ndarray, "tokens 2"]
    pixels: Int[np.ndarray, "points 2"]
    view: CroppedView
    tokens: GarmentTokens

    @property
    def guide(self) -> Guide:
        """Prediction for the garment's vertices."""
        level, height = self.spreads.T
        return Guide(
            self.seen,
            self.tokens.at_vertices(self.places),
            self.tokens.at_vertices(np.sqrt(2.0 * level**2 + height**2)),
            self.tokens.size_m,
        )

    def turned(self, angle_rad: float) -> "TokenAnswer":
        """Return the same answer in a world turned about the vertical through its origin."""
        return replace(
            self,
            seen=self.seen.turned(angle_rad),
            places=self.places @ about_vertical(angle_rad).T,
            view=replace(self.view, camera=self.view.camera.turned(angle_rad)),
        )


class TokenReconstructor:
    """A trained token network."""

    def __init__(self, model: TokenNetwork) -> None:
        """Wrap a network for evaluation."""
        self.model = model.eval()
        self.config: TokenNetworkConfig = model.config

    @classmethod
    def load(cls, path: Path, *, device: str = "cpu") -> "TokenReconstructor":
        """Load the network of a weights file."""
        return cls.of(load_weights(path), device=device)

    @classmethod
    def of(cls, weights: Weights, *, device: str = "cpu") -> "TokenReconstructor":
        """Return the network of loaded weights."""
        model = TokenNetwork(require_tokens(weights))
        weights.load_into(model, prefix=PREFIX)
        return cls(model.to(device))

    def look(self, picture: DepthInput) -> Look:
        """Return the picture as the network sees it."""
        view = crop(picture.depth_m, picture.mask, picture.camera, self.config)
        seen = cloth_pixels(view.depth, self.config)
        points = points_of(view.depth, view.camera, seen.sources)
        return Look(view, seen.pixels, points, _table_height(picture, points))

    def rivals(
        self,
        look: Look,
        tokens: GarmentTokens,
        *,
        views: int = VIEWS,
        most: int = _MOST_PARTIES,
    ) -> list[TokenAnswer]:
        """Return rival answers: all views merged, and each set of agreeing hypotheses merged."""
        height, distance, origin = seen_by_network(look.view, tokens.size_m, look.table_m)
        answers = self._views(height, distance, look.pixels, tokens, views)
        if not np.isfinite(answers.places).all():
            raise InvalidResultError("the network's answer is not finite; give other weights")

        def answer(members: tuple[_Member, ...]) -> TokenAnswer:
            share, place, spread = answers.joined(members)
            canonical, sure = _read(share, tokens)
            return TokenAnswer(
                SeenPoints(look.points, canonical, sure),
                place * tokens.size_m + origin,
                spread * tokens.size_m,
                look.pixels,
                look.view,
                tokens,
            )

        return [answer(members) for members in answers.parties()[:most]]

    def _views(
        self,
        height: Float[np.ndarray, "rows columns"],
        distance: float,
        pixels: np.ndarray,
        tokens: GarmentTokens,
        views: int,
    ) -> "_Views":
        """Return correspondences and hypotheses of each view, in the picture's own frame."""
        last = self.config.output_size - 1
        shown, asked = [], []
        for number in range(views):
            picture, (rows, columns) = height, pixels.T
            if number & 1:
                picture, columns = picture[:, ::-1], last - columns
            if number & 2:
                picture, rows = picture[::-1], last - rows
            if number & 4:
                picture, rows, columns = picture.T, columns, rows
            shown.append(np.ascontiguousarray(picture))
            asked.append(np.stack([rows, columns], axis=1))
        device = self.model.ticks.device
        given = TokenInput(
            torch.from_numpy(np.stack(shown)).float().to(device),
            torch.full((views,), distance, dtype=torch.float32, device=device),
            torch.from_numpy(tokens.features).to(device).expand(views, -1, -1),
            torch.from_numpy(np.stack(asked)).to(device),
        )
        with torch.no_grad(), torch.autocast(device.type, torch.bfloat16):
            output = self.model(given)
        names = output.names.softmax(-1).cpu()
        answers = output.places.double().cpu().numpy()
        places, spreads = answers[..., :3].copy(), np.exp(np.clip(answers[..., 3:], *LOG_SPREADS))
        mirror = torch.from_numpy(tokens.mirror)
        for number in range(views):
            place = places[number]
            if number & 4:
                place[..., :2] = -place[..., [1, 0]]
            if number & 2:
                place[..., 1] *= -1.0
            if number & 1:
                place[..., 0] *= -1.0
            if number.bit_count() % 2:
                # The network saw the mirrored garment, so map its tokens back.
                places[number] = place[:, tokens.mirror]
                spreads[number] = spreads[number][:, tokens.mirror]
                names[number] = names[number][:, mirror]
        likelihoods = output.choice.softmax(-1).double().cpu().numpy()
        return _Views(names, places, spreads, likelihoods, tokens)


@dataclass(frozen=True, eq=False)
class _Views:
    """Hypotheses of all views of one picture, in the picture's own frame.

    Attributes:
        places, spreads: token positions and their spreads, by view and hypothesis.
        likelihoods: likelihoods of the hypotheses of each view; their sum is 1.
    """

    names: Tensor
    places: Float[np.ndarray, "views hypotheses tokens 3"]
    spreads: Float[np.ndarray, "views hypotheses tokens 2"]
    likelihoods: Float[np.ndarray, "views hypotheses"]
    tokens: GarmentTokens

    def parties(self) -> list[tuple["_Member", ...]]:
        """Return sets of hypotheses to merge: the likeliest of each view, and those that agree.

        Each likely hypothesis of any view collects those that agree with it, one per view. The set
        of the likeliest ones is first; the others are sorted by likelihood and truncated.
        """
        views, count = self.likelihoods.shape
        everybody = tuple((view, int(self.likelihoods[view].argmax())) for view in range(views))
        found = [
            self._alike((view, number))
            for view in range(views)
            for number in range(count)
            if self.likelihoods[view, number] >= _LEAST_LIKELY
        ]
        mass = {members: sum(self.likelihoods[one] for one in members) for members in found}
        ranked = sorted(mass, key=lambda members: -mass[members])
        return list(dict.fromkeys([everybody, *ranked]))[:_MOST_PARTIES]

    def joined(
        self, members: tuple["_Member", ...]
    ) -> tuple[Float[np.ndarray, "asked tokens"], np.ndarray, np.ndarray]:
        """Return one answer from some hypotheses, with the symmetry of the most certain one.

        The hypotheses are weighted by their spreads.
        """
        surest = max(members, key=lambda one: self._sure[one[0]])
        share = torch.zeros_like(self.names[0])
        total = np.zeros_like(self.places[0, 0])
        weight = np.zeros((len(total), 1))
        for member in members:
            name, _ = self._named_as(surest, member)
            close = 1.0 / self.spreads[member][name].mean(axis=1, keepdims=True) ** 2
            total += close * self.places[member][name]
            weight += close
            share += self.names[member[0]].index_select(1, torch.from_numpy(name))
        share = share / share.sum(-1, keepdim=True)
        return share.double().numpy(), total / weight, np.sqrt(len(members) / weight) * np.ones(2)

    @cached_property
    def _sure(self) -> list[float]:
        """Mean probability of the likeliest token, per view."""
        return self.names.max(-1).values.mean(-1).tolist()

    def _alike(self, center: "_Member") -> tuple["_Member", ...]:
        """Return hypotheses whose positions agree with one up to symmetry, one per view."""
        apart = self._apart(center, self.places).min(axis=-1)
        return tuple(
            (view, int(gaps.argmin())) for view, gaps in enumerate(apart) if gaps.min() < _ALIKE
        )

    def _named_as(self, center: "_Member", member: "_Member") -> tuple[np.ndarray, float]:
        """Return the symmetry of a hypothesis nearest to another one, and their mean distance."""
        gaps = self._apart(center, self.places[member])
        nearest = int(np.argmin(gaps))
        return self._labelings[nearest], float(gaps[nearest])

    def _apart(
        self, center: "_Member", places: Float[np.ndarray, "*sets tokens 3"]
    ) -> Float[np.ndarray, "*sets labelings"]:
        """Return mean distances of positions from those of a hypothesis, by symmetry."""
        moved = places[..., self._labelings, :] - self.places[center]
        return np.sqrt(np.square(moved).sum(axis=-1)).mean(axis=-1)

    @cached_property
    def _labelings(self) -> Int[np.ndarray, "labelings tokens"]:
        return self.tokens.labelings[self.tokens.is_labeling]


_Member = tuple[int, int]
"""A view and one of its hypotheses."""


def _read(
    share: Float[np.ndarray, "asked tokens"], tokens: GarmentTokens
) -> tuple[Float[np.ndarray, "asked 3"], Float[np.ndarray, " asked"]]:
    """Return canonical positions [m] around the likeliest tokens, and the probability there."""
    around = tokens.neighbors[share.argmax(axis=1)]
    near = np.take_along_axis(share, around, axis=1)
    sure = near.sum(axis=1)
    canonical = np.einsum("pn,pnx->px", near, tokens.canonical[around]) / sure[:, None]
    return canonical, sure


def _table_height(picture: DepthInput, points: Float[np.ndarray, "points 3"]) -> float:
    """Return the height of the table in the world [m]; without a table, of the lowest points."""
    if picture.table is not None:
        return float(picture.table.point[2])
    return float(np.percentile(points[:, 2], 0.5))
