"""Modes are values of one configuration, and contradictions are refused by name."""

import inspect
import json
from dataclasses import asdict, replace

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.files.settings import from_plain
from clothtrack.tracking.calibration import CalibrationConfig
from clothtrack.tracking.configuration import MODES, FinalAlignmentConfig, TrackerConfig, mode
from clothtrack.tracking.pipeline import RunConfig
from clothtrack.tracking.theta import check_parameter


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("attachment_strength", 0.0),
        ("attachment_strength", 1.5),
        ("score_frames", 0),
        ("parameters", {"stretch_compliance": 0.0}),
    ],
)
def test_contradictions_name_the_field(field: str, value: object) -> None:
    with pytest.raises(InvalidConfigError, match=field):
        replace(TrackerConfig(), **{field: value})


@pytest.mark.parametrize(
    ("field", "value"),
    [("iterations", 0), ("rounds", 0), ("roll_s", -0.1)],
)
def test_a_final_alignment_that_cannot_be_is_refused(field: str, value: object) -> None:
    with pytest.raises(InvalidConfigError, match=rf"final_alignment\.{field} is "):
        FinalAlignmentConfig(**{field: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("held_layers", -1.0),
        ("held_layers", 1.5),
        ("table_friction", -0.1),
        ("bend_compliance", float("inf")),
        ("grasp_offset_x_m", float("nan")),
    ],
)
def test_values_that_a_parameter_cannot_take_are_refused_as_start_and_on_an_axis(
    name: str, value: float
) -> None:
    start = {**TrackerConfig().parameters, name: value}
    with pytest.raises(InvalidConfigError, match=f"{name} is {value}"):
        TrackerConfig(parameters=start)
    with pytest.raises(InvalidConfigError, match=f"{name} is {value}"):
        CalibrationConfig(judge="tracking", axes={name: (1.0, value)})


def test_every_ablation_differs_from_the_paper_in_one_switch() -> None:
    paper = vars(mode("full_held_paper"))
    switches = {
        "no_pseudo_action": {"use_pseudo_action"},
        "no_dynamics_initialisation": {"use_dynamics_initialisation"},
        "no_action_conditioning": {"use_action"},
        "no_final_alignment": {"use_final_alignment"},
        "open_loop": {"use_pseudo_action", "use_final_alignment"},
    }
    for name, expected in switches.items():
        other = vars(MODES[name])
        assert {key for key in paper if paper[key] != other[key]} == expected


def test_an_unknown_mode_lists_the_known_ones() -> None:
    with pytest.raises(InvalidConfigError, match="full_held_paper"):
        mode("best")


@pytest.mark.parametrize("name", MODES)
def test_settings_of_a_run_come_back_from_its_result(name: str) -> None:
    config = RunConfig(tracker=MODES[name], seed=5)
    plain = json.loads(json.dumps(asdict(config)))
    assert asdict(from_plain(RunConfig(), plain)) == asdict(config)
    plain["tracker"]["score_frames"] = 0
    with pytest.raises(InvalidConfigError, match="score_frames is 0"):
        from_plain(RunConfig(), plain)
    del plain["seed"]
    with pytest.raises(InvalidConfigError, match="'seed'"):
        from_plain(RunConfig(), plain)


@pytest.mark.parametrize("value", [None, "x", True, float("nan"), float("inf"), [1.0]])
def test_what_is_no_number_is_no_value_to_try(value):
    with pytest.raises(InvalidConfigError, match=r"held_layers is .*; it must be a finite number"):
        # What checks annotations in tests stands before our own check.
        inspect.unwrap(check_parameter)("held_layers", value)
