"""Searches at test time: the turn of the picture, the rival answer, the size and the cut.

One look of a network is a lottery: the same cloth turned by some degrees may become another mesh,
and a garment of unknown size is an answer to every size that is asked. Here each answer is laid
into the picture (`isometric_fit`), and the one that explains it best is taken (`explanation`).
Cheap tries come first, and the search ends when one of them leaves nothing to explain.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.cuts import KnownGarment, cuts, finer
from clothtrack.reconstruction.depth_input import DepthInput
from clothtrack.reconstruction.explanation import Explainer, Explanation
from clothtrack.reconstruction.seen_cloth import SeenCloth
from clothtrack.reconstruction.tokens.token_reconstruction import (
    VIEWS,
    Look,
    TokenAnswer,
    TokenReconstructor,
)

TURNS_DEG = (0.0, 45.0, 22.5, 67.5)
"""By what the picture is turned, one after the other [deg]; quarter turns are asked at once."""

_RIVALS = 5
"""Most answers that are laid, of each turn."""

QUICK = (1.0, 3.0, 10.0)
"""Rounds of a fit that is only to be compared (`isometric_fit.EDGES`)."""

ENOUGH = 0.25
"""Score of an explanation below which nothing else is tried."""

_COARSE = 400
"""Vertices of a garment whose size is not known yet, about."""

SCANNED_VIEWS, DESCENT_VIEWS = 2, 4
"""Quarter turns and mirror images that are asked about while the size is searched."""

SCANNED_SIZES = (0.85, 1.15, 1.6)
"""Longer sides that are tried first, over the extent of what is seen."""

STEPS = (0.2, 0.1)
"""Steps of the logarithms of size and aspect, one round of the descent after the other."""

FARTHEST = 2.0
"""A round goes at most so many steps away."""


@dataclass(frozen=True)
class Choice:
    """A garment and an answer that were tried.

    Attributes:
        cut: of the garment.
        size_m: its width and length [m].
        turn_deg: by what the picture was turned [deg].
        explanation: how well it explains the picture.
    """

    cut: str
    size_m: tuple[float, float]
    turn_deg: float
    explanation: Explanation


@dataclass(frozen=True, eq=False)
class Try:
    """An answer as it was laid into the picture.

    Attributes:
        garment: what was asked about.
        answer: of the network, in the world of the picture.
        vertices: of the garment [m].
        choice: what is said of it.
    """

    garment: KnownGarment
    answer: TokenAnswer
    vertices: Float[np.ndarray, "vertices 3"]
    choice: Choice

    @property
    def score(self) -> float:
        """Of its explanation; less is better."""
        return self.choice.explanation.score


class Search:
    """Tries answers to one picture.

    Attributes:
        cloth: what the picture shows.
        tries: all that was tried, in their order.
    """

    def __init__(
        self, model: TokenReconstructor, picture: DepthInput, *, device: str = "cpu"
    ) -> None:
        """Look at a picture.

        Raises:
            InvalidRecordingError: there is no cloth in it.
        """
        self._model, self._picture, self._device = model, picture, device
        self._looks: dict[float, Look] = {}
        look = self._look(0.0)
        self.cloth = SeenCloth.of(look.view, picture, look.table_m)
        self.tries: list[Try] = []

    @property
    def choices(self) -> tuple[Choice, ...]:
        """The best try of each garment and turn, best first."""
        found: dict[tuple[object, ...], Try] = {}
        for one in sorted(self.tries, key=_score):
            garment = one.garment
            key = garment.cut, garment.size_m, one.choice.turn_deg, garment.mesh.vertex_count
            found.setdefault(key, one)
        return tuple(one.choice for one in found.values())

    def known(self, garment: KnownGarment) -> Try:
        """The best try of a garment of known size: turn after turn, until one is enough."""
        best: Try | None = None
        for turn_deg in TURNS_DEG:
            found = self.tried(garment, turn_deg)
            best = min([found, *([] if best is None else [best])], key=_score)
            if best.score <= ENOUGH:
                break
        assert best is not None
        return best

    def unknown(self, kind: str) -> KnownGarment:
        """The garment of a kind, coarse, whose answer explains the picture best.

        Args:
            kind: "towel", "tshirt" or "trousers".
        """
        extent_m = self.cloth.longest_m
        scanned = []
        for cut in cuts(kind, _COARSE):
            for size in SCANNED_SIZES:
                width, length = (size * extent_m * side for side in cut.size_m)
                scanned.append(self.tried(cut.resized(width, length), views=SCANNED_VIEWS, most=1))
        first = min(scanned, key=_score)
        return self._descended(first, kind).garment

    def best(self, kind: str, template: ClothMesh | None, *, vertex_count: int = 1000) -> Try:
        """The best try of a garment, whether its size is known or not.

        Args:
            kind: "towel", "tshirt" or "trousers".
            template: the flat garment; None when it is not known.
            vertex_count: of the mesh that is made then, about.
        """
        if template is not None:
            return self.known(KnownGarment.of(template, device=self._device))
        return self.known(finer(self.unknown(kind), kind, vertex_count))

    def tried(
        self,
        garment: KnownGarment,
        turn_deg: float = 0.0,
        *,
        views: int = VIEWS,
        most: int = _RIVALS,
    ) -> Try:
        """The best answer about a garment in one turn of the picture.

        Args:
            garment: what is asked about.
            turn_deg: by what the picture is turned [deg].
            views: quarter turns and mirror images that are asked about, 1 to 8.
            most: answers that are laid.
        """
        answers = self._model.rivals(self._look(turn_deg), garment.tokens, views=views, most=most)
        explain = Explainer(garment.mesh, self.cloth, device=garment.device)
        found = []
        for answer in answers:
            back = answer.turned(-np.radians(turn_deg))
            vertices = garment.fit.lay(back.guide, self.cloth, QUICK, layered=False)
            choice = Choice(garment.cut, garment.size_m, turn_deg, explain(vertices))
            found.append(Try(garment, back, vertices, choice))
        self.tries += found
        return min(found, key=_score)

    def _look(self, turn_deg: float) -> Look:
        if turn_deg not in self._looks:
            turned = self._picture.turned(np.radians(turn_deg))
            self._looks[turn_deg] = self._model.look(turned)
        return self._looks[turn_deg]

    def _descended(self, start: Try, kind: str) -> Try:
        """The best try about a size: parabolas through three sizes, and three aspects, in turn."""
        cut, best = start.garment, start

        def asked(place: Float[np.ndarray, " 2"]) -> Try:
            size, aspect = np.exp(place)
            width, length = cut.size_m
            if kind == "towel":
                aspect = min(aspect, width / length)
            return self.tried(
                cut.resized(width * size / np.sqrt(aspect), length * size * np.sqrt(aspect)),
                views=DESCENT_VIEWS,
                most=2,
            )

        place = np.zeros(2)
        best = asked(place)
        for step in STEPS:
            for axis in (0, 1):
                way = step * np.eye(2)[axis]
                best, place = _along(asked, best, place, way)
        return best


def _along(
    asked: "Callable[[Float[np.ndarray, ' 2']], Try]",
    middle: Try,
    place: Float[np.ndarray, " 2"],
    way: Float[np.ndarray, " 2"],
) -> tuple[Try, Float[np.ndarray, " 2"]]:
    """The best try along a way through a place: on either side, and where a parabola is lowest."""
    found = [(middle, place), (asked(place - way), place - way), (asked(place + way), place + way)]
    at, below, above = (one.score for one, _ in found)
    bow = below + above - 2.0 * at
    share = 0.5 * (below - above) / bow if bow > 0.0 else np.sign(below - above) * FARTHEST
    lowest = place + np.clip(share, -FARTHEST, FARTHEST) * way
    found.append((asked(lowest), lowest))
    return min(found, key=lambda pair: pair[0].score)


def _score(one: Try) -> float:
    return one.score
