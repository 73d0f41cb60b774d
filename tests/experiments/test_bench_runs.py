"""Which trajectories there are, and when a run counts as done."""

from dataclasses import replace

import pytest
from shared import bench_runs
from shared.bench_runs import Task, Variant

from clothtrack.tracking.configuration import RunConfig, mode


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
