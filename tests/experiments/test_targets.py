"""Targets are met or missed by what the rows say."""

import pytest
from shared.bench_runs import write_rows
from tables import targets


def row(variant, recording, action, error, **measures):
    return {
        "variant": variant, "recording": recording, "split": "test", "kind": "towel",
        "action": action, "actions": 3, "stage": "after", "vertices": 100,
        "error_all_mm": error, "error_hidden_mm": 2 * error, "crossings_per_1000_edges": 0.5,
        "world_crossings_per_1000_edges": 0.3, "chamfer_pc_m2": 3e-5, "chamfer_floor_m2": 1e-5,
        "provenance": {"commit": "abc", "clothtrack": "0.1.0"},
    } | measures  # fmt: skip


@pytest.fixture
def rows():
    return [
        *(row("default", "towel_0", action, 1.2 * action) for action in (1, 2, 3)),
        *(row("default", "towel_0", a, 9.0, stage="before") for a in (1, 2, 3)),
        *(row("paper", "towel_0", action, 12.0) for action in (1, 2, 3)),
        row("paper", "towel_0", 3, 12.0, stage="before", chamfer_pc_m2=2e-5),
        row("no_final_alignment", "towel_0", 3, 12.0, stage="before", chamfer_pc_m2=1e-5),
    ]


def test_each_target_is_judged_by_its_own_measure(rows):
    found = {one.name: one for one in targets.targets(rows)}
    values = [one.value for one in found.values()]
    assert values == pytest.approx([2.4, 3.6, 20.0, 4.8, 3.0, 0.5, 0, 3.0, 0])
    verdicts = [one.verdict for one in found.values()]
    assert verdicts == ["met"] * 4 + ["missed", "met", "met", "missed", "met"]


def test_a_share_of_the_papers_error_is_one_of_the_same_recordings(rows):
    rows += [row("default", "towel_1", action, 30.0) for action in (1, 2, 3)]
    found = {one.name: one for one in targets.targets(rows)}
    assert found["share of the paper's mode [%]"].value == pytest.approx(20.0)
    assert found["mean vertex error [mm]"].value == pytest.approx(16.2)


@pytest.mark.parametrize(("crossed", "verdict"), [(9, "met"), (10, "missed")])
def test_few_meshes_may_cross_themselves_where_the_world_does_not(rows, crossed, verdict):
    rows += [
        row("default", f"towel_{number}", 1, 3.0, world_crossings_per_1000_edges=0.0)
        for number in range(1, crossed + 1)
    ]
    found = {one.name: one for one in targets.targets(rows)}
    assert found["meshes with over twice the world's crossings"].verdict == verdict


def test_what_is_not_in_the_rows_is_not_judged(rows):
    only = [each for each in rows if each["variant"] == "default" and each["action"] < 3]
    found = {one.name: one.verdict for one in targets.targets(only)}
    assert found["third action / first action"] == "not measured"
    assert found["share of the paper's mode [%]"] == "not measured"


def test_a_failure_counts(rows):
    rows.append({"variant": "default", "recording": "towel_9", "split": "test", "error": "burst"})
    assert targets.targets(rows)[-1].verdict == "missed"


def test_the_order_is_the_papers_or_not(rows, tmp_path, capsys):
    assert targets.order(rows) == (
        ["paper", "no_final_alignment"],
        ["no_final_alignment", "paper"],
    )
    write_rows(rows, tmp_path / "table1.jsonl")
    assert targets.main(["--rows", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "not reproduced" in printed
    assert "| hidden vertices [mm] | 5 | 4.8 | met |" in printed
