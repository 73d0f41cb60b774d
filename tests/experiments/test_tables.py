"""Tables from rows: means per recording, pairs on the same recordings, failures named."""

import numpy as np
import pytest
from shared import tables

STAMP = {"commit": "abc1234", "clothtrack": "0.1.0"}


def row(variant, recording, action, error, *, stage="after", chamfer=1e-4):
    return {
        "experiment": "table1", "variant": variant, "recording": recording, "split": "test",
        "kind": "towel", "action": action, "actions": 2, "stage": stage, "vertices": 100,
        "error_all_mm": error, "error_hidden_mm": None, "chamfer_pc_m2": chamfer,
        "chamfer_floor_m2": 5e-5, "cpu_s": 3.0, "provenance": STAMP,
    }  # fmt: skip


@pytest.fixture
def rows():
    both = []
    for recording, paper, ours in (("towel_0", 10.0, 4.0), ("towel_1", 14.0, 16.0)):
        for action in (1, 2):
            both.append(row("paper", recording, action, paper + action))
            both.append(row("default", recording, action, ours + action))
            both += [
                row(name, recording, action, 50.0, stage="before", chamfer=1e-4 * action)
                for name in ("paper", "default")
            ]
    return both


def line_of(text, start):
    found = [line for line in text.splitlines() if line.startswith(f"| {start} ")]
    return [cell.strip() for cell in found[0].strip("|").split("|")]


def test_a_recording_counts_once_whatever_the_number_of_its_actions(rows):
    rows.append(row("default", "towel_0", 3, 500.0, stage="before"))
    values = tables.ERROR.values([each for each in rows if each["variant"] == "default"])
    assert values == {"towel_0": pytest.approx(5.5), "towel_1": pytest.approx(17.5)}


def test_the_paper_measures_the_last_action_before_the_final_alignment(rows):
    chosen = [each for each in rows if each["variant"] == "default"]
    assert tables.CHAMFER_LAST.cells(chosen) == ["2.00 ± 0.00", "2.00"]
    assert tables.CHAMFER.cells(chosen) == ["1.50"]
    assert tables.FLOOR.cells(chosen) == ["0.50"]


def test_mean_deviation_median_and_count_stand_beside_the_papers_number(rows):
    cells = line_of(tables.means("table1", rows, ["paper", "default"]), "paper")
    assert cells[:3] == ["paper", "1.13", "2"]
    assert f"13.5 ± {np.std([11.5, 15.5], ddof=1):.1f}" in cells
    assert "-" in line_of(tables.means("table1", rows, ["paper", "default"]), "default")


def test_pairs_are_formed_on_the_recordings_that_both_have(rows):
    kept = [each for each in rows if (each["variant"], each["recording"]) != ("default", "towel_1")]
    gaps = tables.differences(rows, "default", "paper", tables.ERROR)
    assert sorted(gaps) == [pytest.approx(-6.0), pytest.approx(2.0)]
    only = tables.differences(kept, "default", "paper", tables.ERROR)
    assert only == pytest.approx([-6.0])
    cells = line_of(tables.pairs(rows, ["paper", "default"], "paper"), "default")
    assert cells[-2:] == ["-2.0 ± 4.0", "1 of 2"]


def test_what_failed_is_named_and_not_averaged(rows):
    broken = {"variant": "default", "recording": "towel_2", "split": "test", "error": "it burst"}
    text = tables.markdown("table1", [*rows, broken])
    assert "- failed: default, towel_2: it burst" in text
    assert "2 recordings of the split test, 100 vertices; clothtrack 0.1.0 at abc1234" in text
    assert "action 1" in text


def test_every_experiment_of_the_paper_has_columns_and_a_title():
    assert set(tables.PAPER) <= set(tables.TITLES) == set(tables.COLUMNS)
    assert set(tables.REFERENCES) <= set(tables.TITLES)
