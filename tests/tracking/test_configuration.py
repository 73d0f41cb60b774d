"""The settings of a run: values that cannot be are refused, and come back from a result."""

import inspect
import json
from dataclasses import asdict, replace

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.files.settings import from_plain, settings_of
from clothtrack.tracking.configuration import (
    MODES,
    ClothConfig,
    ObjectiveConfig,
    RunConfig,
    mode,
)
from clothtrack.tracking.methods import METHODS
from clothtrack.tracking.search import SearchConfig
from clothtrack.tracking.theta import check_parameter


@pytest.mark.parametrize(
    ("owner", "field", "value"),
    [
        (ObjectiveConfig, "iterations", 0),
        (ObjectiveConfig, "rigidity_weight", -1.0),
        (ClothConfig, "thickness_m", 0.0),
        (ClothConfig, "table_friction", -0.1),
        (ClothConfig, "bend_compliance", float("inf")),
        (RunConfig, "cloud_spacing_m", -0.001),
    ],
)
def test_values_that_cannot_be_name_the_field(owner: type, field: str, value: object) -> None:
    with pytest.raises(InvalidConfigError, match=rf"{field} is "):
        owner(**{field: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("held_layers", -1),
        ("held_layers", 1.5),
        ("table_friction", -0.1),
        ("bend_compliance", float("inf")),
        ("grasp_offset_z_m", float("nan")),
    ],
)
def test_values_that_a_parameter_cannot_have_are_refused_on_an_axis(name, value) -> None:
    with pytest.raises(InvalidConfigError, match=f"{name} is {value}"):
        SearchConfig(axes={name: (1.0, value)})


def test_every_mode_has_a_method_of_its_name() -> None:
    assert {name: config.mode for name, config in MODES.items()} == {name: name for name in METHODS}


def test_an_unknown_mode_lists_the_known_ones() -> None:
    with pytest.raises(InvalidConfigError, match="default, paper, open_loop"):
        mode("best")


def test_a_user_can_hold_the_settings_in_the_head() -> None:
    assert len(list(settings_of(RunConfig()))) < 30


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


@pytest.mark.parametrize("value", [None, "x", True, float("nan"), float("inf"), [1.0]])
def test_what_is_no_number_is_no_value_to_try(value):
    with pytest.raises(InvalidConfigError, match=r"held_layers is .*; it must be a finite number"):
        # What checks annotations in tests stands before our own check.
        inspect.unwrap(check_parameter)("held_layers", value)
