"""The experiment on wrong geometry runs end to end on one small towel."""

import json

import pytest
from shared.wrong_geometry import KINDS
from tables import geometry_checks


@pytest.mark.slow
def test_wrong_geometry_of_a_small_towel_is_found(tmp_path, capsys):
    file = tmp_path / "found.json"
    assert geometry_checks.main(["--smoke", "--json", str(file)]) == 0
    report = json.loads(file.read_text())
    assert [row["checks"] for row in report["right"]] == [[]]
    assert [row["kind"] for row in report["wrong"]] == [kind.name for kind in KINDS]
    assert len(KINDS) == 20
    missed = {row["kind"] for row in report["wrong"] if not row["checks"]}
    # Its camera looks straight down, where the inverse of a pose is nearly the pose itself.
    assert missed <= {"inverted"}
    assert report["bare"][0]["checks"] == []
    assert "of 1 right ones, 1 of them once more without their template, 0 are accused" in (
        capsys.readouterr().out
    )
