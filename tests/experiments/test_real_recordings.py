"""The command around the sets: what is absent is skipped with a reason, figures are means."""

import json

import pytest
from real import hanging_cloth, robot_clouds, tshirt_pair
from tables import real_recordings


def test_absent_sets_are_skipped_with_a_reason(tmp_path, capsys):
    out = tmp_path / "figures.json"
    assert real_recordings.main(["--data", str(tmp_path), "--json", str(out)]) == 0
    figures = json.loads(out.read_text())
    assert set(figures) == {hanging_cloth.NAME, robot_clouds.NAME, tshirt_pair.NAME}
    printed = capsys.readouterr().out
    for name, figure in figures.items():
        assert f"{name}: skipped, there is no" in printed
        assert figure == {"skipped": f"there is no {tmp_path / name}"}


def row(sequence, mode, mean):
    return {
        "sequence": sequence,
        "mode": mode,
        "chamfer_pc_m2": mean,
        "median_m2": mean,
        "worst_frame_m2": 2 * mean,
        "cloud_to_mesh_m2": 0.5 * mean,
        "band_as_target_m2": mean,
        "band_as_target_worst_m2": mean,
        "edge_strain": 0.01,
    }


def test_the_robot_figures_are_means_and_maxima_by_mode():
    rows = [
        row("lift_a", "default", 1e-4),
        row("fold_b", "default", 3e-4),
        row("lift_a", "open_loop", 8e-4),
        {"sequence": "fold_b", "mode": "open_loop", "error": "no cloth is found"},
    ]
    figures = real_recordings.by_mode(rows, ("default", "open_loop"))
    assert figures["mean"] == pytest.approx({"default": 2e-4, "open_loop": 8e-4})
    assert figures["mean_fold"] == pytest.approx({"default": 3e-4})
    assert figures["worst_frame"] == pytest.approx({"default": 6e-4, "open_loop": 1.6e-3})
    assert figures["edge_strain"]["default"] == pytest.approx(0.01)
    assert figures["default_mode"] == "default"
    assert figures["rows"] == rows
    text = real_recordings.table(robot_clouds.NAME, rows)
    assert "no cloth is found" in text
    assert "mean of 2" in text


def test_a_lost_print_is_printed_as_lost_and_written_as_null():
    figures = {
        "sequence": "x", "mode": "default", "chamfer_surface_m2": 1e-4, "worst_frame_m2": 2e-4,
        "edge_strain": 0.0, "pattern_drift_mm": None, "pattern_matched": 0.0,
    }  # fmt: skip
    assert "lost" in real_recordings.table(hanging_cloth.NAME, [figures])
    head = real_recordings.head([figures])
    assert head["pattern_drift_mm"] is None
    assert head["mode"] == "default"
