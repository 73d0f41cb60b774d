"""Offline parameters are the modes of the online ones."""

from dataclasses import replace

import pytest
from shared.experiment import Setup
from tables import calibration, printed_grid

from clothtrack.tracking import mode, search


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
    assert config.search.method == "none"
    assert config.cloth.table_friction == 3.0
    assert config.cloth.bend_compliance == mode("default").cloth.bend_compliance


def test_the_printed_grid_has_180_combinations_and_is_tried_whole(tmp_path):
    setup = Setup(tmp_path, tmp_path)
    grid, descent = printed_grid.PRINTED, setup.variant("descent", "paper")
    assert [len(values) for values in grid.values()] == [5, 6, 6]
    proposal = search.grid(grid)
    candidates = next(proposal)
    assert len(set(candidates)) == 180
    with pytest.raises(StopIteration) as end:
        proposal.send([float(one == candidates[77]) * -1.0 for one in candidates])
    assert end.value.value == candidates[77]
    # Nothing but the search differs from the paper's mode.
    (tmp_path / "recordings" / "towel_0").mkdir(parents=True)
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "towel_0.npz").touch()
    (_, first), (_, printed) = printed_grid.plan(setup)
    assert first == descent
    assert printed.config.search.method == "grid"
    assert replace(printed.config, search=descent.config.search) == descent.config
