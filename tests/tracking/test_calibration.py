"""Grid, halving and descent against a known score whose optimum is on the grid."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.tracking.calibration import CalibrationConfig, calibrate, ranked
from clothtrack.tracking.configuration import TrackerConfig
from clothtrack.tracking.theta import PARAMETERS

START = {**TrackerConfig().parameters, "table_friction": 1.0, "particle_friction": 1.0}
BEST = {"bend_compliance": 1e-2, "table_friction": 3.0, "particle_friction": 0.3}
COLUMNS = [PARAMETERS.index(name) for name in BEST]


def bowl(candidates: np.ndarray, share: float) -> np.ndarray:
    """Separable, convex in the logarithms; short prefixes see the same valley, only flatter."""
    distance = np.log(candidates[:, COLUMNS]) - np.log(list(BEST.values()))
    return 1e-4 + share * 1e-4 * (distance**2).sum(axis=1)


@pytest.mark.parametrize("method", ["grid", "halving", "descent"])
def test_finds_the_optimum_of_a_bowl(method: str) -> None:
    config = CalibrationConfig(method=method)
    chosen, record = calibrate(bowl, START, config)
    assert {name: chosen[name] for name in BEST} == BEST
    assert record.scores[record.best] == record.scores.min() == pytest.approx(1e-4)
    assert len(record.scores) == len(record.candidates)
    if method != "grid":
        assert record.roll_outs < 0.7 * config.size


def test_the_grid_tries_every_combination_once() -> None:
    config = CalibrationConfig(method="grid")
    _, record = calibrate(bowl, START, config)
    assert len(record.scores) == config.size == record.roll_outs
    assert len(np.unique(record.candidates, axis=0)) == config.size


def test_none_keeps_the_start() -> None:
    chosen, record = calibrate(bowl, START, CalibrationConfig(method="none"))
    assert chosen == START
    assert record.best == -1
    assert record.roll_outs == 0


def test_parameters_off_the_axes_reach_the_score_unchanged() -> None:
    start = {**START, "grasp_offset_z_m": -0.02}

    def score(candidates: np.ndarray, _: float) -> np.ndarray:
        assert (candidates[:, PARAMETERS.index("grasp_offset_z_m")] == -0.02).all()
        return np.zeros(len(candidates))

    calibrate(score, start, CalibrationConfig(method="grid"))


def test_an_exploded_candidate_is_the_worst_one() -> None:
    config = replace(CalibrationConfig(method="grid"), axes={"table_friction": (0.1, 0.2, 0.3)})
    scores = iter([np.array([np.nan, 2.0, np.inf])])
    chosen, record = calibrate(lambda *_: next(scores), START, config)
    assert chosen["table_friction"] == 0.2
    assert np.isinf(record.scores[[0, 2]]).all()


def test_descent_starts_at_the_previous_optimum() -> None:
    first = []

    def score(candidates: np.ndarray, share: float) -> np.ndarray:
        first.append(candidates[:, PARAMETERS.index("table_friction")].copy())
        return bowl(candidates, share)

    calibrate(score, {**START, "table_friction": 2.9}, CalibrationConfig(method="descent"))
    assert (first[0] == 3.0).all()


def test_descent_ends_as_soon_as_it_is_near_enough() -> None:
    config, ended = CalibrationConfig(method="descent"), []
    start_score = bowl(np.array([[START[name] for name in PARAMETERS]]), 1.0)[0]
    for enough in (1.01 * start_score, 0.99 * start_score, 1.01e-4, 0.99e-4, 0.0):
        chosen, record = calibrate(bowl, START, replace(config, enough=enough))
        ended.append((len(record.scores), chosen))
        if enough > 1e-4:
            assert record.scores[record.best] <= enough
    tried, chosen = zip(*ended, strict=True)
    assert (tried[0], chosen[0]) == (1, START)
    assert 1 < tried[1] < tried[2] < tried[3] == tried[4]
    assert chosen[2] == chosen[3] == chosen[4]


@pytest.mark.parametrize(("share", "friction"), [(0.95, 1.0), (0.85, 3.0)])
def test_descent_leaves_a_candidate_only_for_a_clearly_better_one(share, friction) -> None:
    def score(candidates: np.ndarray, _: float) -> np.ndarray:
        return np.where(candidates[:, PARAMETERS.index("table_friction")] == 3.0, share, 1.0)

    config = CalibrationConfig(axes={"table_friction": (1.0, 3.0)}, clearly=0.1)
    chosen, record = calibrate(score, START, config)
    assert chosen["table_friction"] == friction
    assert record.candidates[record.best] == [friction]
    assert len(record.scores) == 2


def test_an_uncertain_grasp_adds_its_offset_to_the_search() -> None:
    config = CalibrationConfig()
    assert config.with_grasp_offset(0.0) is config
    wider = config.with_grasp_offset(0.02)
    assert wider.axes["grasp_offset_z_m"] == pytest.approx((-0.02, -0.01, 0.0, 0.01, 0.02))
    assert wider.size == config.size * 5


def test_without_anything_to_score_the_start_is_kept() -> None:
    chosen, record = calibrate(None, START, CalibrationConfig())
    assert chosen == START
    assert record.method == "none"


def test_unknown_and_empty_axes_are_refused() -> None:
    with pytest.raises(InvalidConfigError, match="table_friction"):
        CalibrationConfig(axes={"stickiness": (1.0,)})
    with pytest.raises(InvalidConfigError, match="no value"):
        CalibrationConfig(axes={"table_friction": ()})


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("method", "annealing", "none, grid, halving, descent"),
        ("judge", "truth", "open_loop, tracking"),
        ("sweeps", 0, "at least 1"),
        ("rank", 1.5, "from 0 to 1"),
    ],
)
def test_settings_that_no_search_can_have_are_refused(field, value, told) -> None:
    # The type checks of the tests would refuse a wrong word before the configuration itself does.
    config = CalibrationConfig()
    object.__setattr__(config, field, value)
    with pytest.raises(InvalidConfigError, match=f"{field} is .*{told}"):
        config.__post_init__()


@pytest.mark.parametrize(("rank", "score"), [(0.0, 1.0), (0.5, 3.0), (0.9, 5.0), (1.0, 5.0)])
def test_a_rank_is_a_share_of_the_candidates_that_score_better(rank: float, score: float) -> None:
    scores = np.array([5.0, 1.0, np.inf, 3.0, 2.0, 4.0])
    assert scores[ranked(scores, rank)] == score


def test_layers_cannot_be_searched_open_loop() -> None:
    with pytest.raises(InvalidConfigError, match=r"held_layers.*judge"):
        CalibrationConfig(axes={"held_layers": (1.0, 2.0)})
