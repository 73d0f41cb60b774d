"""Every experiment over the benchmark runs end to end on one small towel, filmed once."""

import importlib
import json

import pytest
from figures import error_sources, method_strip
from shared import tables
from shared.bench_runs import read_rows
from tables import label_quality

EXPERIMENTS = {
    "table1": 9,
    "default_ablations": 18,
    "calibration": 8,
    "printed_grid": 2,
    "final_alignment": 6,
    "collision": 5,
    "sensitivity": 15,
    "model_free": 4,
}
MEASURES = (
    "error_all_mm", "error_visible_mm", "error_all_p95_mm", "chamfer_pc_m2", "chamfer_floor_m2",
    "edge_strain", "crossings", "close_pairs", "below_table", "world_crossings", "cpu_s",
    "part_swapped_mm", "error_without_slip_mm",
)  # fmt: skip


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return tmp_path_factory.mktemp("bench")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "variants"), EXPERIMENTS.items())
def test_an_experiment_runs(name, variants, bench, capsys):
    if name == "table1":
        pytest.importorskip("torch", reason="the extra [learn] brings it")
    if name == "model_free":
        pytest.importorskip("biocpd", reason="the extra [experiments] brings it")
    module = importlib.import_module(f"tables.{name}")
    assert module.main(["--smoke", "--bench", str(bench)]) == 0
    printed = capsys.readouterr().out
    lines = (bench / "experiments" / f"{name}.jsonl").read_text().splitlines()
    rows = [json.loads(line) for line in lines]
    assert not [row["error"] for row in rows if "error" in row]
    assert len({row["variant"] for row in rows}) == variants
    for row in rows:
        assert row["experiment"] == name
        assert all(row[key] is not None for key in MEASURES)
        assert set(row["provenance"]) >= {"commit", "clothtrack", "packages", "seed", "config_hash"}
        assert "machine" not in row["provenance"]
        groups = sum(row[f"part_{group}_mm"] for group in ("visible", "hidden", "swapped"))
        assert groups == pytest.approx(row["error_all_mm"], rel=1e-3)
    assert tables.markdown(name, rows) in printed


@pytest.mark.slow
def test_settings_reach_the_tracker(bench):
    """Runs that differ in one setting differ in what they track."""
    file = bench / "experiments" / "sensitivity.jsonl"
    if not file.exists():
        pytest.skip("needs the rows of the sensitivity experiment")
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    errors = {row["variant"]: row["error_all_mm"] for row in rows if row["stage"] == "after"}
    for axis in ("rigidity", "vertices", "thickness", "cloud", "first mesh", "noise"):
        values = [error for name, error in errors.items() if name.startswith(f"{axis}=")]
        assert len(set(values)) == 2, axis


def test_a_second_call_tracks_nothing(bench, capsys):
    table1 = importlib.import_module("tables.table1")
    assert table1.main(["--smoke", "--bench", str(bench), "--only", "open_loop"]) == 0
    capsys.readouterr()
    assert table1.main(["--smoke", "--bench", str(bench), "--only", "open_loop"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "open_loop" in captured.out


@pytest.mark.slow
def test_pictures_are_drawn_from_the_rows(bench, tmp_path, capsys):
    table1 = importlib.import_module("tables.table1")
    table1.main(["--smoke", "--bench", str(bench), "--only", "default", "open_loop"])
    strip = tmp_path / "strip.png"
    arguments = ["--bench", str(bench), "--recording", "towel_0000", "--image", str(strip)]
    assert method_strip.main(arguments) == 0
    assert strip.stat().st_size > 10_000
    assert method_strip.main([*arguments[:3], "towel_9999", *arguments[4:]]) == 1
    pytest.importorskip("matplotlib", reason="the extra [experiments] brings it")
    figure = tmp_path / "figure.png"
    rows = str(bench / "experiments")
    assert error_sources.main(["--rows", rows, "--image", str(figure)]) == 0
    assert figure.stat().st_size > 10_000
    assert "error by action" in capsys.readouterr().out


@pytest.mark.slow
def test_labels_are_judged_from_what_a_run_leaves(bench, tmp_path, capsys):
    table1 = importlib.import_module("tables.table1")
    table1.main(["--smoke", "--bench", str(bench), "--only", "default"])
    rows = bench / "experiments"
    capsys.readouterr()
    assert label_quality.main(["--bench", str(bench), "--rows", str(rows)]) == 0
    assert "rank correlation" in capsys.readouterr().out
    (judged,) = read_rows(rows / "label_quality.jsonl")
    assert 0.0 < judged["expected_error_mm"] < 50.0
    arguments = ["--fit", "--model", str(tmp_path / "model.json")]
    assert label_quality.main(["--bench", str(bench), "--rows", str(rows), *arguments]) == 1
    assert "table1.py --split dev" in capsys.readouterr().err
