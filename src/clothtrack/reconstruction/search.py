"""Searches at test time over the turn of the picture, the rival answers, the size and the cut.

A single network pass is unreliable: the same cloth turned by a few degrees may give another mesh,
and for a garment of unknown size the network answers for any size it is given. The search fits each
answer to the picture (`isometric_fit`) and takes the one that explains it best (`explanation`).
Cheap tries come first, and the search ends when a try explains the picture well enough.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

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
"""Angles by which the picture is turned, in order [deg]; each includes its quarter turns."""

_RIVALS = 5
"""Maximum number of answers that are fitted per turn."""

QUICK = (1.0, 3.0, 10.0)
"""Edge weights per round of a fit that is only used for comparison (`isometric_fit.EDGES`)."""

ENOUGH = 0.25
"""Score of an explanation at or below which the search stops."""

_LEAST_TURNS = 2
"""Number of turns that are always tried. How far their answers lie apart predicts the error of the
mesh; three predict it no better."""

_COARSE = 400
"""Approximate vertex count of a garment whose size is not known yet."""

SCANNED_VIEWS, DESCENT_VIEWS = 2, 4
"""Number of quarter turns and mirror images per query during the size scan and the descent."""

SCANNED_SIZES = (0.85, 1.15, 1.6)
"""Longer sides that are tried first, over the extent of the observed cloth."""

STEPS = (0.2, 0.1)
"""Steps of the logarithms of size and aspect, one per round of the descent."""

FARTHEST = 2.0
"""Largest move of a round, in steps."""


@dataclass(frozen=True)
class Choice:
    """A garment and an answer that were tried.

    Attributes:
        size_m: its width and length [m].
        turn_deg: angle by which the picture was turned [deg].
    """

    cut: str
    size_m: tuple[float, float]
    turn_deg: float
    explanation: Explanation


@dataclass(frozen=True, eq=False)
class Try:
    """An answer fitted to the picture.

    Attributes:
        garment: garment that the network was queried with.
        answer: answer of the network, in the world of the picture.
        vertices: vertices of the garment [m].
        choice: summary of the try that is reported.
    """

    garment: KnownGarment
    answer: TokenAnswer
    vertices: Float[np.ndarray, "vertices 3"]
    choice: Choice

    @property
    def score(self) -> float:
        """Score of its explanation; lower is better."""
        return self.choice.explanation.score


class Search:
    """Search among the network's answers for one picture.

    Attributes:
        cloth: the observed cloth.
        tries: all tries, in order.
    """

    def __init__(
        self, model: TokenReconstructor, picture: DepthInput, *, device: str = "cpu"
    ) -> None:
        """Encode a picture.

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
        """Return the best try of a garment of known size, over turns until one is good enough.

        The first two turns are always tried (`spread_over_turns`).
        """
        found: list[Try] = []
        for turn_deg in TURNS_DEG:
            found.append(self.tried(garment, turn_deg))
            if len(found) >= _LEAST_TURNS and min(one.score for one in found) <= ENOUGH:
                break
        return min(found, key=_score)

    def unknown(self, kind: str) -> KnownGarment:
        """Return the coarse garment of a kind whose answer explains the picture best.

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

    def best(self, kind: str, *, vertex_count: int = 1000) -> Try:
        """Return the best try of a garment of unknown size.

        Args:
            kind: "towel", "tshirt" or "trousers".
            vertex_count: approximate vertex count of the mesh.
        """
        return self.known(finer(self.unknown(kind), kind, vertex_count))

    def spread_over_turns(
        self, garment: KnownGarment, vertices: Float[np.ndarray, "vertices 3"]
    ) -> float:
        """Return how far the answers in the first two turns of the picture lie from a mesh.

        That is the mean distance of the tokens, up to symmetry, over the longer side of the
        garment, of the farther answer.

        Args:
            garment: garment that `known` was called with.
            vertices: vertices of its mesh [m].
        """
        tokens, faces = garment.tokens, garment.mesh.faces
        labelings = tokens.labelings[tokens.is_labeling]
        own, apart = tokens.places(vertices, faces), []
        for turn_deg in TURNS_DEG[:_LEAST_TURNS]:
            tried = (
                one for one in self.tries
                if one.garment is garment and one.choice.turn_deg == turn_deg
            )  # fmt: skip
            laid = tokens.places(min(tried, key=_score).vertices, faces)
            apart.append(np.linalg.norm(laid[labelings] - own, axis=-1).mean(axis=-1).min())
        return float(max(apart) / tokens.size_m)

    def tried(
        self,
        garment: KnownGarment,
        turn_deg: float = 0.0,
        *,
        views: int = VIEWS,
        most: int = _RIVALS,
    ) -> Try:
        """Return the best answer for a garment in one turn of the picture.

        Args:
            garment: garment that the network is queried with.
            turn_deg: angle by which the picture is turned [deg].
            views: number of quarter turns and mirror images in the query, 1 to 8.
            most: maximum number of answers that are fitted.
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
        """Return the best try near a size, by alternating parabola fits over size and aspect."""
        cut = start.garment

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
    """Return the best try along a direction: the middle, both sides and a parabola's minimum."""
    found = [(middle, place), (asked(place - way), place - way), (asked(place + way), place + way)]
    at, below, above = (one.score for one, _ in found)
    bow = below + above - 2.0 * at
    share = 0.5 * (below - above) / bow if bow > 0.0 else np.sign(below - above) * FARTHEST
    lowest = place + np.clip(share, -FARTHEST, FARTHEST) * way
    found.append((asked(lowest), lowest))
    return min(found, key=lambda pair: pair[0].score)


def _score(one: Try) -> float:
    return one.score
