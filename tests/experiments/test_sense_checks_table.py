"""The experiment on contradicting senses runs end to end on one small towel."""

import json

from shared.wrong_senses import SENSE_KINDS
from tables import sense_checks


def test_contradictions_of_a_small_towel_are_found(tmp_path, capsys):
    file = tmp_path / "found.json"
    assert sense_checks.main(["--smoke", "--json", str(file)]) == 0
    report = json.loads(file.read_text())
    assert [*report["right"].values()] == [[]]
    assert [row["wrong"] for row in report["wrong"]] == [kind.text for kind in SENSE_KINDS]
    drawn = [row for row in report["wrong"] if row["draws"]]
    assert sum(row["found"] for row in drawn) >= 0.8 * len(drawn)
    assert "of 1 right recordings 0 are accused" in capsys.readouterr().out
