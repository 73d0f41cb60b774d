"""Pretraining and fine-tuning from files to files, as the command line does them."""

import json
import resource
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from clothtrack.cli import command_line as cli
from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.garments.garment_meshes import garment
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture
from clothtrack.reconstruction.data.pseudo_labels import LabeledRecording, write_labels
from clothtrack.reconstruction.data.state_store import StateShard, write_states
from clothtrack.reconstruction.training.checkpoint import (
    load_progress,
    load_weights,
    save_weights,
)
from clothtrack.reconstruction.training.training_run import PROGRESS
from clothtrack_lab.published_networks.model import MeshReconstructor, network_of
from clothtrack_lab.published_networks.network_config import PRESETS, TINY_NETWORK, preset
from clothtrack_lab.published_networks.published_config import (
    STAGES,
    training_preset,
)
from clothtrack_lab.published_networks.registered import SHIPPED

FEW = [
    "canonicalisation.epochs=2",
    "completion.epochs=2",
    "completion.batch_size=4",
    "examples.winding.pool=1024",
    "examples.surface_queries=64",
    "examples.volume_queries=64",
]


PRETRAIN = ("pretrain", "--network", "small")


def settings(*more):
    return [word for one in (*FEW, *more) for word in ("--set", one)]


@pytest.fixture
def towels(tmp_path, monkeypatch):
    """A folder of states; the smallest network stands in for `small`."""
    monkeypatch.setitem(PRESETS, "small", TINY_NETWORK)
    mesh = garment("towel", vertex_count=150)
    flat = np.asarray(mesh.vertices, np.float32) + np.float32([0.0, 0.0, 0.005])
    shard = StateShard("towel", mesh, np.stack([flat] * 8), np.arange(8), ("flat",) * 8, 0)
    write_states(tmp_path / "states", "towel", [shard], {})
    return tmp_path


def labels_of(folder, count=3):
    mesh = garment("towel", vertex_count=150)
    from clothtrack.reconstruction.data.render_config import RenderConfig
    from clothtrack_lab.published_networks.rendered_state import render

    flat = np.asarray(mesh.vertices) + (0.0, 0.0, 0.005)
    for number in range(count):
        picture = render(flat, mesh, RenderConfig(), np.random.default_rng(number))
        assert isinstance(picture, LabeledPicture)
        one = LabeledRecording(f"t{number}", "towel", mesh, (0,), (picture,))
        write_labels(one, folder / f"t{number}.labels.npz")


def test_pretrained_weights_are_finetuned(towels, capsys):
    run, tuned, labels = towels / "run", towels / "tuned", towels / "labels"
    words = [*PRETRAIN, str(towels / "states"), "--output", str(run), *settings()]
    assert cli.main(words) == 0
    weights = load_weights(run / "model.safetensors")
    assert weights.kind == "towel"
    assert set(weights.provenance) == {"canonicalisation", "completion"}
    assert network_of(weights) == TINY_NETWORK
    labels_of(labels)
    capsys.readouterr()
    words = ["finetune", str(run / "model.safetensors"), str(labels), "--output", str(tuned)]
    more = ["--json", "--seed", "3"]
    assert cli.main([*words, *more, *settings("canonicalisation.high_rate=1e-3")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["stages"]["canonicalisation"]["status"] in ("finished", "converged")
    after = load_weights(tuned / "model.safetensors")
    assert after.tensors.keys() == weights.tensors.keys()
    for name, value in after.tensors.items():
        # Fine-tuning keeps the statistics of batch norm.
        if "running_" in name:
            assert torch.equal(value, weights.tensors[name]), name
    assert after.provenance["completion"]["data"]["labels"] == 3


def start_of(path, kind):
    model = MeshReconstructor(TINY_NETWORK, kind)
    save_weights(path, model.state_dict(), TINY_NETWORK, kind=kind)
    return load_weights(path)


def test_pretraining_goes_on_from_weights(towels):
    start, run = towels / "start.safetensors", towels / "run"
    before = start_of(start, "towel")
    # At such a rate nothing moves: what comes out is what went in, and not a fresh network.
    rates = ("low_rate", "high_rate")
    still = [f"{stage}.{rate}=1e-12" for stage in STAGES for rate in rates]
    words = [*PRETRAIN, str(towels / "states"), "--output", str(run), "--start", str(start)]
    assert cli.main([*words, *settings(*still)]) == 0
    after = load_weights(run / "model.safetensors")
    for name, value in before.tensors.items():
        if value.is_floating_point() and "running_" not in name:
            torch.testing.assert_close(after.tensors[name], value, atol=1e-6, rtol=0.0)
    assert after.provenance["completion"]["data"]["start"]["kind"] == "towel"


def test_pretraining_does_not_go_on_from_another_garment_or_network(towels, capsys, monkeypatch):
    start = towels / "start.safetensors"
    words = [*PRETRAIN, str(towels / "states"), "--output", str(towels / "run"), *settings()]
    start_of(start, "tshirt")
    assert cli.main([*words, "--start", str(start)]) == 1
    assert "is for 'tshirt', the states are of 'towel'" in capsys.readouterr().err
    start_of(start, "towel")
    monkeypatch.setitem(PRESETS, "small", replace(TINY_NETWORK, bins=TINY_NETWORK.bins * 2))
    assert cli.main([*words, "--start", str(start)]) == 1
    assert "has other sizes" in capsys.readouterr().err
    assert not (towels / "run").exists()


def test_shipped_weights_name_sizes_that_nobody_varies_any_more():
    found = load_weights(SHIPPED / "towel.safetensors")
    assert found.network["encoder"] == "unet"
    assert network_of(found) == preset("small")
    with pytest.raises(InvalidResultError, match="encoder"):
        network_of(replace(found, network={**found.network, "encoder": "hrnet_w32"}))


def test_a_file_that_claims_a_huge_network_takes_no_memory(tmp_path):
    """What the file says is compared with what it holds before anything of that size is made."""
    path = tmp_path / "weights.safetensors"
    start_of(path, "towel")
    found = load_weights(path)
    assert network_of(found) == TINY_NETWORK
    huge = {**asdict(TINY_NETWORK), "widths": [2048] * 8, "volume_widths": [2048] * 4}
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InvalidResultError, match="another preset"):
        network_of(type(found)(path, found.tensors, huge, "towel"))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000
    for wrong in ({"bins": 16.5}, {"image_size": "64"}, {"widths": 8}):
        with pytest.raises(InvalidResultError, match="none that this version knows"):
            network_of(type(found)(path, found.tensors, {**asdict(TINY_NETWORK), **wrong}, "towel"))
    with pytest.raises(InvalidResultError, match="sock"):
        network_of(type(found)(path, found.tensors, asdict(TINY_NETWORK), "sock"))


def test_the_paper_preset_is_the_paper():
    epochs = [
        training_preset("paper", stage).epochs for stage in ("canonicalisation", "completion")
    ]
    assert epochs == [1000, 2000]
    assert training_preset("paper", "completion").patience == 0
    assert training_preset("finetune", "completion").patience > 0
    with pytest.raises(InvalidConfigError, match="paper"):
        training_preset("papier", "completion")


def test_more_epochs_go_on_from_the_progress_of_fewer(towels):
    words = [*PRETRAIN, str(towels / "states"), "--output", str(towels / "run")]
    assert cli.main([*words, *settings()]) == 0
    assert cli.main([*words, *settings("canonicalisation.epochs=3", "completion.epochs=3")]) == 0
    for stage, batch_size in (("canonicalisation", 8), ("completion", 4)):
        progress = load_progress(towels / "run" / stage / PROGRESS)
        # Seven of the eight states are learned from.
        assert progress["step"] == 3 * (7 // min(batch_size, 7))
