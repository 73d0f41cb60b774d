"""The experiment on the picker in pictures runs end to end on one small towel."""

import json

import pytest
from tables import picker_from_pictures


@pytest.mark.slow
def test_the_picker_of_a_small_film_is_found_within_the_target(tmp_path, capsys):
    assert picker_from_pictures.main(["--smoke", "--out", str(tmp_path)]) == 0
    (row,) = map(json.loads, (tmp_path / "picker_from_pictures.jsonl").read_text().splitlines())
    assert row["median_mm"] < 5.0
    assert row["picks_found"] == row["picks"] == 1
    assert row["pick_off"] <= 2
    assert "| median_mm |" in capsys.readouterr().out
