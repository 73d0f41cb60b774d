"""The experiment on clicks in place of a path runs end to end on one small towel."""

import json

import pytest
from tables import bare_hand


@pytest.mark.slow
def test_a_hand_by_clicks_is_tracked_beside_its_true_path(tmp_path, capsys):
    assert bare_hand.main(["--smoke", "--out", str(tmp_path)]) == 0
    (row,) = map(json.loads, (tmp_path / "bare_hand.jsonl").read_text().splitlines())
    assert row["seen"] is True
    assert row["pick_mm"] < 10.0
    assert row["path_mm"] < 25.0
    assert row["error_true_mm"] < 10.0
    assert row["error_clicked_mm"] < 15.0
    assert "| error_clicked_mm |" in capsys.readouterr().out
