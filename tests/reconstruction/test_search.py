"""The search at test time: when it stops, which size it finds, and that a turn changes nothing."""

from dataclasses import replace

import numpy as np
import pytest
import seen_above as above
import torch

from clothtrack.garments.garment_meshes import towel
from clothtrack.reconstruction.availability import shipped_weights
from clothtrack.reconstruction.cuts import KnownGarment, cuts
from clothtrack.reconstruction.explanation import OUTLINE, Explanation
from clothtrack.reconstruction.model_loading import load_model
from clothtrack.reconstruction.search import ENOUGH, TURNS_DEG, Choice, Search, Try
from clothtrack.reconstruction.tokens.token_network import TokenNetwork, TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_reconstruction import TokenReconstructor

SIZE_M = (0.4, 0.3)


@pytest.fixture(scope="module")
def untrained():
    torch.manual_seed(0)
    return TokenReconstructor(TokenNetwork(TokenNetworkConfig(width=16, layers=1, hypotheses=1)))


@pytest.fixture(scope="module")
def flat():
    return towel(*SIZE_M, 0.02)


@pytest.fixture(scope="module")
def folded(flat):
    return above.half_folded(flat, at_m=0.08)


@pytest.fixture(scope="module")
def picture(flat, folded):
    return above.picture_of(folded, flat.faces)


@pytest.fixture(scope="module")
def answer(untrained, picture, flat):
    look = untrained.look(picture)
    return untrained.rivals(look, KnownGarment.of(flat).tokens, views=1)[0]


class Scored(Search):
    """A search whose tries explain the picture as well as a function says."""

    def __init__(self, model, picture, answer, score):
        super().__init__(model, picture)
        self.answer, self.score = answer, score

    def tried(self, garment, turn_deg=0.0, **_):
        explanation = Explanation(self.score(garment, turn_deg) / OUTLINE, 0.0, 0.0, 0.0, 0.0)
        choice = Choice(garment.cut, garment.size_m, turn_deg, explanation)
        one = Try(garment, self.answer, np.asarray(garment.mesh.vertices), choice)
        self.tries.append(one)
        return one


@pytest.fixture
def scored(untrained, picture, answer):
    return lambda score: Scored(untrained, picture, answer, score)


@pytest.mark.parametrize("enough_at", range(len(TURNS_DEG)))
def test_turns_are_tried_until_one_is_enough_and_two_at_least(scored, flat, enough_at):
    search = scored(lambda _, turn_deg: (0.9 if turn_deg == TURNS_DEG[enough_at] else 1.1) * ENOUGH)
    best = search.known(KnownGarment.of(flat))
    assert [one.choice.turn_deg for one in search.tries] == list(TURNS_DEG[: max(enough_at + 1, 2)])
    assert best.choice.turn_deg == TURNS_DEG[enough_at]


def test_the_spread_over_turns_is_the_distance_of_the_farther_answer_up_to_symmetry(scored, flat):
    search = scored(lambda *_: 0.5 * ENOUGH)
    garment = KnownGarment.of(flat)
    search.known(garment)
    vertices = np.asarray(flat.vertices, float)
    assert search.spread_over_turns(garment, vertices) == pytest.approx(0.0, abs=1e-6)
    # The same rectangle, named the other way round.
    center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    half_turned = (vertices - center) * (-1.0, -1.0, 1.0) + center
    assert search.spread_over_turns(garment, half_turned) < 0.01
    beside = vertices + (0.0, 0.0, 0.1)
    assert search.spread_over_turns(garment, beside) == pytest.approx(0.1 / max(SIZE_M), rel=1e-3)
    search.tries[1] = replace(search.tries[1], vertices=vertices + (0.2, 0.0, 0.0))
    assert search.spread_over_turns(garment, vertices) == pytest.approx(0.2 / max(SIZE_M), rel=0.2)


def bowl(cut, size_m, weights=(1.0, 0.3)):
    """A score that is lowest at one cut and size: square in the logarithms of area and aspect."""

    def score(garment, _):
        width, length = np.log(garment.size_m) - np.log(size_m)
        other = 0.0 if garment.cut == cut else 1.0
        return 0.3 + other + weights[0] * (width + length) ** 2 + weights[1] * (width - length) ** 2

    return score


@pytest.mark.parametrize(
    "case",
    [("towel", 1.0, 1.0), ("towel", 1.7, 0.9), ("tshirt", 0.75, 1.1), ("trousers", 1.3, 0.85)],
)
def test_the_size_that_explains_best_is_found(scored, case):
    kind, size, aspect = case
    cut = cuts(kind, 400)[-1]
    longest_m = scored(lambda *_: 1.0).cloth.longest_m
    width, length = (size * longest_m * side for side in cut.size_m)
    wanted = (width * aspect**0.5, length / aspect**0.5)
    search = scored(bowl(cut.cut, wanted))
    found = search.unknown(kind)
    assert found.cut == cut.cut
    np.testing.assert_allclose(found.size_m, wanted, rtol=1e-6)
    # No size is asked twice as often as there are steps to it.
    assert len(search.tries) < 40


@pytest.fixture(scope="module")
def shipped():
    assert shipped_weights() is not None
    return load_model("towel").network


def half_turned(vertices, flat):
    """The same cloth with its vertices named by each turn of the rectangle by half."""
    columns, rows = len(np.unique(flat.vertices[:, 0])), len(np.unique(flat.vertices[:, 1]))
    grid = vertices.reshape(rows, columns, 3)
    return [grid[::a, ::b].reshape(-1, 3) for a in (1, -1) for b in (1, -1)]


def distance(vertices, other, flat):
    """Mean distance [m], whatever corner of the towel has which name."""
    namings = half_turned(other, flat)
    return min(np.linalg.norm(vertices - one, axis=1).mean() for one in namings)


def test_a_folded_towel_is_found_and_a_quarter_turn_turns_it(shipped, picture, flat, folded):
    garment = KnownGarment.of(flat)
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    straight = Search(shipped, picture).tried(garment)
    turned = Search(shipped, picture.turned(0.5 * np.pi)).tried(garment)
    assert straight.score < 2.0 * ENOUGH
    assert distance(straight.vertices, folded, flat) < 0.05 * max(SIZE_M)
    # Half a pixel of the picture, which is rounded to whole ones once more.
    assert distance(turned.vertices, straight.vertices @ quarter.T, flat) < 0.01 * max(SIZE_M)
    assert turned.score == pytest.approx(straight.score, abs=0.03)


def test_the_turn_of_a_try_is_turned_back(shipped, picture, flat, folded):
    found = Search(shipped, picture).tried(KnownGarment.of(flat), 45.0)
    assert found.choice.turn_deg == 45.0
    assert distance(found.vertices, folded, flat) < 0.05 * max(SIZE_M)
