"""A folder that was begun for one thing is not gone on with for another."""

import json

import pytest

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.files.run_manifest import begin_run, require_same

ASKED = {"seed": 1, "config": {"planner": {"strip_m": 0.06}, "reach": (0.05, 0.2)}}


def test_a_folder_goes_on_with_its_own_settings(tmp_path):
    path = tmp_path / "out" / "asked.json"
    begin_run(path, ASKED)
    written = path.read_bytes()
    begin_run(path, ASKED)
    assert path.read_bytes() == written
    assert json.loads(written)["config"]["reach"] == [0.05, 0.2]


def test_what_differs_is_named_with_both_values(tmp_path):
    path = tmp_path / "asked.json"
    begin_run(path, ASKED)
    other = {**ASKED, "config": {**ASKED["config"], "planner": {"strip_m": 0.0}}}
    with pytest.raises(InvalidConfigError, match=r"config\.planner\.strip_m \(0\.06, now 0\.0"):
        begin_run(path, other)
    with pytest.raises(InvalidConfigError, match=r"another new \(null, now 3\)"):
        begin_run(path, {**ASKED, "new": 3})
    with pytest.raises(InvalidConfigError, match=r"another seed \(1, now null\)"):
        require_same(path, {"seed": 1}, {})
    assert json.loads(path.read_text())["seed"] == 1


def test_a_damaged_file_is_told(tmp_path):
    path = tmp_path / "asked.json"
    path.write_text("{")
    with pytest.raises(InvalidResultError, match="remove the folder"):
        begin_run(path, ASKED)
