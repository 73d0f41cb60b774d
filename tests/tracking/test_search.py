"""Grid and descent against a known score whose optimum is on the grid."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.tracking.configuration import PAPER_AXES, RunConfig
from clothtrack.tracking.search import Scores, SearchConfig, coordinate_descent, grid

START = replace(RunConfig().cloth.theta(), table_friction=1.0, particle_friction=1.0)
AXES = dict(PAPER_AXES)
BEST = (1e-2, 3.0, 0.3)


def bowl(values) -> float:
    """Separable, convex in the logarithms."""
    return 1e-4 + 1e-4 * float(((np.log(values) - np.log(BEST)) ** 2).sum())


def searched(proposal, score=bowl):
    """The chosen candidate, and all scores."""
    scores, asked = Scores(AXES), next(proposal)
    while True:
        for values in scores.missing(asked):
            scores.add(values, score(values))
        try:
            asked = proposal.send([scores[values] for values in asked])
        except StopIteration as end:
            return end.value, scores


def descent(**settings):
    return coordinate_descent(AXES, START, **{"sweeps": 2, **settings})


@pytest.mark.parametrize("propose", [lambda: grid(AXES), descent])
def test_finds_the_optimum_of_a_bowl(propose) -> None:
    chosen, scores = searched(propose())
    record = scores.record("any", "open_loop", chosen)
    assert chosen == BEST
    assert record.scores[record.best] == record.scores.min() == pytest.approx(1e-4)
    assert record.roll_outs == len(record.scores) == len(record.candidates)


def test_an_exploded_candidate_is_the_worst_one() -> None:
    values = iter([np.nan, 2.0, np.inf])
    chosen, scores = searched(grid({"table_friction": (0.1, 0.2, 0.3)}), lambda _: next(values))
    assert chosen == (0.2,)
    assert np.isinf([scores[(0.1,)], scores[(0.3,)]]).all()


def test_descent_ends_as_soon_as_a_candidate_is_good_enough() -> None:
    at_start = tuple(getattr(START, name) for name in AXES)
    assert all(value in AXES[name] for name, value in zip(AXES, at_start, strict=True))
    ended = []
    for stop in (1.01 * bowl(at_start), 0.99 * bowl(at_start), 1.01e-4, 0.99e-4, 0.0):
        chosen, scores = searched(descent(stop_score=stop))
        ended.append((scores.record("descent", "tracking", chosen).roll_outs, chosen))
        if stop > 1e-4:
            assert scores[chosen] <= stop
    tried, chosen = zip(*ended, strict=True)
    assert (tried[0], chosen[0]) == (1, at_start)
    assert 1 < tried[1] < tried[2] < tried[3] == tried[4]
    assert chosen[2] == chosen[3] == chosen[4]


@pytest.mark.parametrize(("share", "friction"), [(0.95, 1.0), (0.85, 3.0)])
def test_descent_leaves_a_candidate_only_for_a_clearly_better_one(share, friction) -> None:
    axes = {"table_friction": (1.0, 3.0)}
    proposal = coordinate_descent(axes, START, sweeps=2, min_improvement=0.1)
    chosen, _ = searched(proposal, lambda values: share if values == (3.0,) else 1.0)
    assert chosen == (friction,)


def test_unknown_and_empty_axes_are_refused() -> None:
    with pytest.raises(InvalidConfigError, match="table_friction"):
        SearchConfig(axes={"stickiness": (1.0,)})
    with pytest.raises(InvalidConfigError, match="no value"):
        SearchConfig(axes={"table_friction": ()})


@pytest.mark.parametrize("method", ["grid", "descent"])
def test_layers_cannot_be_searched_open_loop(method) -> None:
    with pytest.raises(InvalidConfigError, match=r"held_layers.*method"):
        SearchConfig(method=method, axes={"held_layers": (1, 2)})
