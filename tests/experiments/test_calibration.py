"""Offline parameters are the modes of the online ones; ranks are shares of the candidates."""

import calibration
import numpy as np
import pytest
from ranked_tracker import ranked

from clothtrack.tracking.configuration import mode
from clothtrack.tracking.tracked_trajectory import Calibration


def chosen(**parameters):
    rows = [{"stage": stage, "parameters": parameters} for stage in ("before", "after")]
    return [*rows, {"error": "burst"}]


def test_the_most_frequent_value_of_each_parameter_wins():
    rows = [
        *chosen(table_friction=0.3, bend_compliance=1.0),
        *chosen(table_friction=1.0, bend_compliance=1.0),
        *chosen(table_friction=1.0, bend_compliance=100.0),
        *chosen(table_friction=0.3, bend_compliance=100.0),
        *chosen(table_friction=3.0, bend_compliance=100.0),
    ]
    assert calibration.most_frequent(rows) == {"table_friction": 0.3, "bend_compliance": 100.0}


def test_offline_parameters_are_not_searched_again():
    config = calibration.fixed(mode("default"), {"table_friction": 3.0})
    assert config.calibration.method == "none"
    assert config.parameters["table_friction"] == 3.0
    assert config.parameters["bend_compliance"] == mode("default").parameters["bend_compliance"]


@pytest.mark.parametrize(("rank", "score"), [(0.0, 1.0), (0.5, 3.0), (0.9, 5.0), (1.0, 5.0)])
def test_a_rank_is_a_share_of_the_candidates_that_score_better(rank, score):
    scores = np.array([5.0, 1.0, np.inf, 3.0, 2.0, 4.0])
    found = Calibration("grid", ("a",), np.arange(6.0)[:, None], scores, 1, 6.0)
    assert scores[ranked(found, rank)] == score
