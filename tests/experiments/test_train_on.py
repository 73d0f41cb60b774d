"""A round of training: fresh states, some steps, a row of figures; the next round goes on."""

import json

import pytest
import torch
from tables import train_on

from clothtrack.files import content_hash
from clothtrack.reconstruction.training.checkpoint import load_weights


@pytest.mark.slow
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
    whole = load_weights(tmp_path / "run" / "model.safetensors")
    shipped = tmp_path / "shipped.safetensors"
    assert train_on.main([*command, "--ship", str(shipped)]) == 0
    assert content_hash(shipped) in capsys.readouterr().out
    halves = load_weights(shipped)
    assert shipped.stat().st_size < 0.6 * whole.path.stat().st_size
    for name, value in whole.tensors.items():
        torch.testing.assert_close(
            halves.tensors[name].to(value.dtype), value, rtol=1e-3, atol=1e-6
        )


def test_the_seed_that_judges_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        train_on.main(["--output", str(tmp_path), "--seed", str(train_on.JUDGE_SEED)])
    assert "makes the states that judge" in capsys.readouterr().err
