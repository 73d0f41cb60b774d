"""Weights on disk: what was written comes back, and what is bad is refused and runs nothing."""

import logging
import pickle
import resource
from functools import partial
from io import BytesIO
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from clothtrack.errors import InvalidResultError, StorageError
from clothtrack.reconstruction.training.checkpoint import (
    load_progress,
    load_weights,
    save_progress,
    save_weights,
)

DESCRIBED = {"format": "clothtrack-weights", "version": "1", "kind": "towel"}


class Hostile:
    """Writes a file when it is unpickled."""

    def __init__(self, target):
        self.target = str(target)

    def __reduce__(self):
        return Path.write_text, (Path(self.target), "executed")


@pytest.fixture
def weights(line, tmp_path):
    """A whole weights file and the stage that it was written from."""
    stage = line.LineStage(seed=3)
    path = tmp_path / "weights.safetensors"
    save_weights(
        path, stage.trained.state_dict(), stage.network, kind="towel", provenance={"seed": 3}
    )
    return path, stage


def test_weights_come_back_to_the_bit(line, weights):
    path, stage = weights
    found = load_weights(path)
    assert (found.kind, found.network, found.provenance) == ("towel", {"hidden": 8}, {"seed": 3})
    other = line.LineStage(seed=4)
    found.load_into(other.trained)
    for name, value in stage.trained.state_dict().items():
        assert torch.equal(value, other.trained.state_dict()[name]), name


def test_weights_that_are_no_numbers_are_refused(line, tmp_path):
    stage = line.LineStage()
    with torch.no_grad():
        stage.trained[0].bias[2] = float("nan")
    path = tmp_path / "nan.safetensors"
    save_weights(path, stage.trained.state_dict(), stage.network, kind="towel")
    with pytest.raises(InvalidResultError, match=r"0\.bias is not finite"):
        load_weights(path).load_into(stage.trained)


@pytest.mark.parametrize(
    ("described", "told"),
    [
        (None, "expected 'clothtrack-weights'"),
        ({**DESCRIBED, "network": "{", "provenance": "{}"}, "damaged"),
        ({**DESCRIBED, "network": "3", "provenance": "{}"}, "settings"),
    ],
)
def test_weights_of_others_are_refused(tmp_path, described, told):
    path = tmp_path / "other.safetensors"
    with pytest.raises(InvalidResultError, match="no such weights"):
        load_weights(path)
    save_file({"a": torch.zeros(2)}, path, described)
    with pytest.raises(InvalidResultError, match=told):
        load_weights(path)


def test_one_altered_byte_of_weights_is_noticed(weights):
    path, _ = weights
    whole = path.read_bytes()
    for place in range(8, len(whole), 7):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(InvalidResultError, match=r"weights\.safetensors: "):
            load_weights(path)
    path.write_bytes(whole[:-1])
    with pytest.raises(InvalidResultError, match=r"weights\.safetensors: not a whole"):
        load_weights(path)


def test_weights_from_before_digests_are_read_and_said_to_be(weights, caplog):
    path, stage = weights
    described = {**DESCRIBED, "network": '{"hidden": 8}', "provenance": "{}"}
    save_file(stage.trained.state_dict(), path, described)
    with caplog.at_level(logging.INFO):
        load_weights(path).load_into(stage.trained)
    assert "without SHA-256" in caplog.text
    save_file(stage.trained.state_dict(), path, {**described, "sha25v": "1"})
    with pytest.raises(InvalidResultError, match="'sha25v'"):
        load_weights(path)


@pytest.mark.parametrize("name", ["weights.safetensors", "progress.pt"])
@pytest.mark.parametrize("writer", ["pickle", "torch"])
def test_a_hostile_file_runs_nothing(tmp_path, name, writer):
    target, path = tmp_path / "executed", tmp_path / name
    content = {"format": "clothtrack-training-progress", "version": 1, "step": Hostile(target)}
    if writer == "pickle":
        path.write_bytes(pickle.dumps(content))
    else:
        torch.save(content, path)
    read = load_weights if name.startswith("weights") else load_progress
    with pytest.raises(InvalidResultError, match=name):
        read(path)
    assert not target.exists()
    # The same file does harm to who unpickles it: the trap is a real one.
    unpickle = pickle.load if writer == "pickle" else partial(torch.load, weights_only=False)
    unpickle(BytesIO(path.read_bytes()))
    assert target.read_text() == "executed"


@pytest.mark.parametrize(
    ("document", "told"),
    [
        ({"state_dict": torch.zeros(2)}, "not the progress"),
        ({"format": "clothtrack-training-progress", "version": 99}, "version 99"),
        (torch.zeros(2), "not the progress"),
    ],
)
def test_progress_of_others_is_refused(tmp_path, document, told):
    torch.save(document, tmp_path / "progress.pt")
    with pytest.raises(InvalidResultError, match=told):
        load_progress(tmp_path / "progress.pt")


def test_a_full_disk_is_told_and_not_pytorch_s_error_of_it(tmp_path):
    path = tmp_path / "progress.pt"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(StorageError, match="free some space"):
            save_progress(path, {"step": 1, "weights": torch.zeros(10_000)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not list(tmp_path.iterdir())


def test_weights_of_another_preset_are_refused_and_change_nothing(line, weights):
    path, _ = weights
    layers = torch.nn.Sequential
    for other, told in (
        (line.LineStage(hidden=16).trained, "another preset"),
        (layers(*line.LineStage().trained, torch.nn.PReLU()), "lacks"),
        (layers(torch.nn.Linear(3, 8)), "does not know"),
    ):
        before = {name: value.clone() for name, value in other.state_dict().items()}
        with pytest.raises(InvalidResultError, match=told):
            load_weights(path).load_into(other)
        for name, value in other.state_dict().items():
            assert torch.equal(value, before[name])


def test_truncated_progress_is_refused(tmp_path):
    path = tmp_path / "progress.pt"
    save_progress(path, {"step": 7, "weights": {"a": torch.arange(3000.0)}})
    whole = path.read_bytes()
    for share in (0.0, 0.01, 0.98):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InvalidResultError, match=r"progress\.pt: not the progress"):
            load_progress(path)
