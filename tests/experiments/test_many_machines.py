"""Shared work that is killed is compared with that of one process."""

import json

import pytest
from tables import many_machines


@pytest.mark.slow
def test_two_pools_of_which_one_is_killed_do_the_work_of_one_process(tmp_path, capsys):
    pytest.importorskip("torch", reason="the extra [learn] brings it")
    assert many_machines.main(["--smoke", "--json", str(tmp_path / "table.json")]) == 0
    rows = json.loads((tmp_path / "table.json").read_text())["rows"]
    assert [row["way"] for row in rows] == ["alone", "two pools at once"]
    assert all(row["same_bits"] and row["labels"] == 2 for row in rows)
    assert "| two pools at once |" in capsys.readouterr().out
