"""Means over recordings and actions, and the pairing with open loop."""

import pytest
import world_tracking

BEFORE = world_tracking.STAGES["before"]


def row(recording, mode, action, error):
    return {
        "recording": recording, "mode": mode, "action": action, "stage": BEFORE,
        "error_all_mm": error, "error_visible_mm": error, "error_hidden_mm": float("nan"),
        "error_p95_mm": 2 * error, "chamfer_pc_m2": 1e-4, "chamfer_floor_m2": 5e-5,
        "edge_strain": 0.01, "crossings": 0,
    }  # fmt: skip


def test_modes_are_paired_with_open_loop_on_the_same_meshes():
    rows = [
        row("towel_0", "default", 1, 3.0),
        row("towel_0", "default", 2, 9.0),
        row("tshirt_0", "default", 1, 5.0),
        row("towel_0", "open_loop", 1, 6.0),
        row("towel_0", "open_loop", 2, 8.0),
        {"recording": "tshirt_0", "mode": "open_loop", "error": "diverged"},
    ]
    summary = world_tracking.summarise(rows, ("default", "open_loop"))
    of = {(s["mode"], s["kind"], s["action"]): s for s in summary}
    towels = of["default", "towel", None]
    assert towels["error_all_mm"] == pytest.approx(6.0)
    assert towels["against_open_loop_mm"] == pytest.approx(-1.0)
    assert (towels["better_than_open_loop"], towels["pairs"]) == (1, 2)
    assert of["default", None, None]["meshes"] == 3
    assert of["default", None, None]["error_hidden_mm"] is None
    assert "pairs" not in of["default", "tshirt", 1]
    text = world_tracking.table(summary)
    assert "-1.00 mm, better in 1 of 2" in text
