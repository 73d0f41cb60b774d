"""A round of training: fresh states, some steps, a row of figures; the next round goes on."""

import json

import pytest

pytest.importorskip("torch", reason="the extra [learn] brings it")
pytest.importorskip("matplotlib", reason="the extra [experiments] brings it")

from tables import train_on

from clothtrack.reconstruction.training.checkpoint import load_weights


def test_a_second_round_goes_on_with_more_states(tmp_path, capsys):
    command = ["--smoke", "--output", str(tmp_path), "--garments", "towel"]
    assert train_on.main([*command, "--seed", "1"]) == 0
    assert train_on.main([*command, "--seed", "2"]) == 0
    capsys.readouterr()
    first, second = json.loads((tmp_path / "rounds.json").read_text())["rounds"]
    assert 0 < first["examples"] < second["examples"]
    assert first["towel"]["states"] == 2
    assert second["towel"]["all_mm"] > 0.0
    assert (tmp_path / "curve.png").read_bytes()[:4] == b"\x89PNG"
    phases = load_weights(tmp_path / "run" / "model.safetensors").provenance["phases"]
    assert [len(phase["data"]["sets"]) for phase in phases] == [1, 2]
    assert phases[1]["data"]["sets"][0] == phases[0]["data"]["sets"][0]


def test_the_seed_that_judges_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        train_on.main(["--output", str(tmp_path), "--seed", str(train_on.JUDGE_SEED)])
    assert "makes the states that judge" in capsys.readouterr().err
