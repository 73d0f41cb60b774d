"""The settings of a run: values that cannot be are refused, and come back from a result."""

import json
from dataclasses import asdict, replace

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.files.settings import from_plain
from clothtrack.tracking.configuration import (
    MODES,
    ClothConfig,
    ObjectiveConfig,
    RunConfig,
    mode,
)
from clothtrack.tracking.methods import METHODS
from clothtrack.tracking.search import SearchConfig


def axis(**values: object) -> SearchConfig:
    """Settings of a search with a value on an axis."""
    return SearchConfig(axes={name: (1.0, value) for name, value in values.items()})


@pytest.mark.parametrize(
    ("owner", "field", "value"),
    [
        (ObjectiveConfig, "iterations", 0),
        (ClothConfig, "thickness_m", 0.0),
        (ClothConfig, "bend_compliance", float("inf")),
        (RunConfig, "cloud_spacing_m", -0.001),
        (axis, "held_layers", 1.5),
        (axis, "table_friction", -0.1),
        (axis, "grasp_offset_z_m", float("nan")),
    ],
)
def test_values_that_cannot_be_name_the_field(owner, field: str, value: object) -> None:
    with pytest.raises(InvalidConfigError, match=rf"{field} is {value}"):
        owner(**{field: value})


def test_every_mode_has_a_method_of_its_name() -> None:
    assert {name: config.mode for name, config in MODES.items()} == {name: name for name in METHODS}


def test_an_unknown_mode_lists_the_known_ones() -> None:
    with pytest.raises(InvalidConfigError, match="default, paper, open_loop"):
        mode("best")


@pytest.mark.parametrize("name", MODES)
def test_settings_of_a_run_come_back_from_its_result(name: str) -> None:
    config = replace(MODES[name], seed=5)
    plain = json.loads(json.dumps(asdict(config)))
    assert asdict(from_plain(RunConfig(), plain)) == asdict(config)
    plain["cloud_spacing_m"] = -1.0
    with pytest.raises(InvalidConfigError, match="cloud_spacing_m is -1"):
        from_plain(RunConfig(), plain)
    del plain["seed"]
    with pytest.raises(InvalidConfigError, match="'seed'"):
        from_plain(RunConfig(), plain)
