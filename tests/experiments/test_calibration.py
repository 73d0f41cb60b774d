"""Offline parameters are the modes of the online ones."""

from tables import calibration

from clothtrack.tracking import mode


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
