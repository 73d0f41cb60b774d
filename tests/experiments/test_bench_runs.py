"""Which trajectories there are, and when a run counts as done."""

import json
from dataclasses import replace

import pytest
from shared import bench_runs
from shared.bench_runs import Task, Trajectory, Variant

from clothtrack.errors import InvalidConfigError
from clothtrack.tracking import RunConfig, mode


@pytest.fixture
def bench(tmp_path):
    for name in ("towel_0", "towel_1", "tshirt_0", "tshirt_1"):
        for stream in ("depth", "color"):
            (tmp_path / "recordings" / name / stream).mkdir(parents=True)
            (tmp_path / "recordings" / name / stream / "000000.png").write_text("far")
        (tmp_path / "recordings" / name / "recording.json").write_text(name)
        (tmp_path / "truth").mkdir(exist_ok=True)
        (tmp_path / "truth" / f"{name}.npz").write_text(name)
    (tmp_path / "recordings" / ".tshirt_2.partial").mkdir()
    return tmp_path


def names(found):
    return [each.name for each in found]


def test_a_folder_without_a_list_is_one_split_and_garments_take_turns(bench):
    assert names(bench_runs.trajectories(bench)) == ["towel_0", "tshirt_0", "towel_1", "tshirt_1"]
    assert names(bench_runs.trajectories(bench, "test", 3)) == ["towel_0", "tshirt_0", "towel_1"]
    assert {each.kind for each in bench_runs.trajectories(bench)} == {"towel", "tshirt"}


def test_the_list_says_which_split_a_trajectory_is_in(bench):
    splits = {"towel_0": "dev", "towel_1": "test", "tshirt_1": "test", "towel_9": "test"}
    entries = [{"name": n, "kind": n[:-2], "split": split} for n, split in splits.items()]
    (bench / "bench.json").write_text(json.dumps({"trajectories": entries}))
    assert names(bench_runs.trajectories(bench, "test")) == ["towel_1", "tshirt_1"]
    assert names(bench_runs.trajectories(bench)) == ["towel_0", "tshirt_1", "towel_1"]
    with pytest.raises(InvalidConfigError, match="'hard'"):
        bench_runs.trajectories(bench, "hard")


def test_a_trajectory_without_truth_is_left_out(bench):
    (bench / "truth" / "towel_0.npz").unlink()
    assert "towel_0" not in names(bench_runs.trajectories(bench))


def test_a_run_is_another_one_when_any_setting_changes_but_its_name():
    base = Variant("a")
    same = replace(base, name="b")
    others = [
        replace(base, vertex_count=500),
        replace(base, first_mesh_error=0.0),
        replace(base, config=mode("open_loop")),
        replace(base, config=RunConfig(cloud_spacing_m=0.01)),
    ]
    assert base.digest == same.digest
    assert len({base.digest, *(each.digest for each in others)}) == len(others) + 1


@pytest.mark.parametrize("changed", ["depth/000000.png", "color/000000.png", "recording.json"])
def test_a_run_is_another_one_when_the_recording_is_made_anew(bench, changed):
    def digest():
        bench_runs._content_digest.cache_clear()
        return bench_runs.trajectories(bench)[0].digest

    before = digest()
    assert digest() == before
    (bench / "recordings" / "towel_0" / changed).write_text("near")
    after = digest()
    assert after != before
    (bench / "truth" / "towel_0.npz").write_text("other")
    assert digest() not in {before, after}


@pytest.fixture
def task(bench):
    return Task(bench_runs.trajectories(bench)[0], Variant("a"), bench / "runs")


def test_what_is_done_is_read_and_what_fails_is_tried_again(task, monkeypatch):
    made = []

    def fail(one):
        made.append(one)
        return [{"error": "no cloth"}]

    monkeypatch.setattr(bench_runs, "make", fail)
    said = []
    assert bench_runs.run_all([task], progress=said.append) == [[{"error": "no cloth"}]]
    assert said == ["a, towel_0: no cloth\n"]
    bench_runs.run_all([task])
    assert len(made) == 2
    bench_runs.write_rows([{"cpu_s": 1.0, "error_all_mm": float("nan")}], task.file)
    assert bench_runs.run_all([task]) == [[{"cpu_s": 1.0, "error_all_mm": None}]]
    assert len(made) == 2


def test_one_run_serves_two_names(task, monkeypatch):
    made = []

    def succeed(one):
        made.append(one)
        bench_runs.write_rows([{"cpu_s": 1.0}], one.file)
        return [{"cpu_s": 1.0}]

    monkeypatch.setattr(bench_runs, "make", succeed)
    twin = replace(task, variant=replace(task.variant, name="b"))
    assert bench_runs.run_all([task, twin]) == [[{"cpu_s": 1.0}]] * 2
    assert len(made) == 1


def test_rows_are_whole_or_absent(tmp_path, monkeypatch):
    file = tmp_path / "rows.jsonl"
    with pytest.raises(TypeError):
        bench_runs.write_rows([{"a": 1}, {"b": object()}], file)
    assert not file.exists()


def test_a_recording_that_cannot_be_read_is_a_row(task):
    (row,) = bench_runs.make(task)
    assert "towel_0" in row["error"]
    assert not task.file.exists()
    assert isinstance(task.trajectory, Trajectory)
