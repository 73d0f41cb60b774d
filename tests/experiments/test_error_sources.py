"""The four questions of the figure, answered from rows."""

import pytest
from figures import error_sources
from figures.error_sources import causes, contributions, drift, shape_or_place


def row(variant, recording="towel_0", action=1, **measures):
    return {
        "variant": variant, "recording": recording, "kind": recording.partition("_")[0],
        "action": action, "actions": 2, "stage": "after", "error_all_mm": 6.0,
        "error_visible_mm": 5.0, "error_hidden_mm": 9.0, "error_without_slip_mm": 4.0,
        "part_visible_mm": 3.0, "part_hidden_mm": 2.0, "part_swapped_mm": 1.0,
    } | measures  # fmt: skip


def test_a_cause_costs_what_the_error_falls_without_it_on_the_same_recordings():
    rows = {
        "sensitivity": [
            row("first mesh=1", "towel_0", error_all_mm=6.0),
            row("first mesh=1", "towel_1", error_all_mm=9.0),
            row("first mesh=0", "towel_0", error_all_mm=5.0),
            row("first mesh=0", "towel_1", error_all_mm=6.0),
            row("first mesh=0", "towel_2", error_all_mm=0.0),
        ]
    }
    (found,) = causes(rows)
    assert found == ("exact first mesh", pytest.approx(2.0), pytest.approx(1.0), 2)


def test_the_groups_add_up_and_garments_stand_apart():
    rows = {"table1": [row("default"), row("default", "tshirt_0"), row("open_loop")]}
    assert contributions(rows) == [("towel 1", 3.0, 2.0, 1.0), ("T-shirt 1", 3.0, 2.0, 1.0)]


def test_drift_is_read_from_the_longest_trajectories_there_are():
    table1 = [row("default", action=1), row("default", action=2, error_all_mm=8.0)]
    actions, lines = drift({"table1": table1})
    assert (actions, lines["all"]) == ([1, 2], [6.0, 8.0])
    six = [row("actions=1 to 6", action=each, error_all_mm=float(each)) for each in range(1, 7)]
    actions, lines = drift({"table1": table1, "sensitivity": six})
    assert lines["all"] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


def test_slip_is_what_a_rigid_motion_takes_away():
    rows = {"table1": [row("paper")], "model_free": [row("the same, blind to the tool")]}
    assert shape_or_place(rows) == [("paper", 2.0, 4.0)]


def test_every_panel_does_without_rows(tmp_path):
    pytest.importorskip("matplotlib", reason="the extra [experiments] brings it")
    image = tmp_path / "empty.png"
    assert error_sources.draw({}, image) == image
    assert error_sources.main(["--rows", str(tmp_path)]) == 1
