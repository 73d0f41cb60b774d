"""Which network weights are of, what it needs, and what of it is shipped."""

import pytest
import torch

from clothtrack.api.options import require_learning
from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.reconstruction import availability, model_loading
from clothtrack.reconstruction.availability import shipped_weights
from clothtrack.reconstruction.design import Reconstructor
from clothtrack.reconstruction.model_loading import (
    TOKENS,
    design_of,
    designs,
    load_model,
)
from clothtrack.reconstruction.training.checkpoint import Weights, load_weights
from clothtrack_lab.published_networks.registered import PUBLISHED, SHIPPED


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_shipped_weights_of_every_design_load(kind):
    for path, design in ((shipped_weights(), TOKENS), (SHIPPED / f"{kind}.safetensors", PUBLISHED)):
        weights = load_weights(path)
        assert design_of(weights) is design
        assert [one for one in designs() if one.recognizes(weights)] == [design]
        network = load_model(kind, path)
        assert isinstance(network, Reconstructor)
        assert network.states_error == (design is TOKENS)


def test_weights_that_no_package_knows_are_refused_by_name(tmp_path, monkeypatch):
    strange = Weights(tmp_path / "strange.safetensors", {"a": torch.zeros(1)}, {}, "towel")
    with pytest.raises(InvalidResultError, match=r"strange.*for 'towel'.*clothtrack_lab"):
        design_of(strange)
    published = load_weights(SHIPPED / "towel.safetensors")
    monkeypatch.setattr(model_loading, "entry_points", lambda group: ())
    with pytest.raises(InvalidResultError, match=r"towel\.safetensors.*clothtrack_lab"):
        design_of(published)


def test_a_network_that_nobody_has_is_refused_with_those_that_there_are(tmp_path, capsys):
    words = ["pretrain", str(tmp_path), "--output", str(tmp_path / "out"), "--network", "huge"]
    assert cli.main(words) == 1
    assert "choose one of tokens, small\n" in capsys.readouterr().err


def test_a_missing_extra_is_named_with_its_remedy(monkeypatch):
    monkeypatch.setattr(availability, "EXTRA", ("torch", "no_such_module"))
    with pytest.raises(InvalidConfigError, match=r"no_such_module.*install with: .*learn"):
        require_learning()


@pytest.mark.parametrize("verb", ["label", "pretrain"])
def test_nothing_to_work_on_is_wrong_usage(verb, tmp_path, capsys):
    more = ["--recordings", str(tmp_path)] if verb == "label" else []
    assert cli.main([verb, "--output", str(tmp_path), *more]) == 2
    assert "given" in capsys.readouterr().err
