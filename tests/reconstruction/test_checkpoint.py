"""Weights on disk: what was written comes back, and what is bad is refused and runs nothing."""

import json
import logging
import os
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


def test_the_runs_that_led_to_weights_are_told_one_by_one(line, tmp_path):
    """Weights of before held each the one before; what is written now lists them."""
    first = {"step": 1, "data": {"states": 5}}
    second = {"step": 2, "data": {"states": 6, "start": first}}
    third = {
        "step": 3,
        "data": {"states": 8, "start": second},
        "phases": [{"from_step": 0, "data": {"states": 7, "start": second}}],
    }
    stage = line.LineStage(seed=3)

    def written(provenance):
        path = tmp_path / "weights.safetensors"
        save_weights(
            path, stage.trained.state_dict(), stage.network, kind="towel", provenance=provenance
        )
        return load_weights(path)

    weights = written(third)
    for step in (4, 5):
        weights = written({"step": step, "data": {"start": weights.runs}})
    assert weights.runs == [
        first,
        {"step": 2, "data": {"states": 6}},
        {
            "step": 3,
            "data": {"states": 8},
            "phases": [{"from_step": 0, "data": {"states": 7}}],
        },
        {"step": 4, "data": {}},
        {"step": 5, "data": {}},
    ]


def test_a_part_is_chosen_by_its_prefix(line, tmp_path):
    stages = {"first": line.LineStage(seed=1), "second": line.LineStage(seed=2)}
    tensors = {
        f"{name}.{key}": value
        for name, stage in stages.items()
        for key, value in stage.trained.state_dict().items()
    }
    path = tmp_path / "both.safetensors"
    save_weights(path, tensors, stages["first"].network, kind="towel")
    other = line.LineStage(seed=9)
    load_weights(path).load_into(other.trained, prefix="second.")
    assert torch.equal(other.trained[0].weight, stages["second"].trained[0].weight)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.99])
def test_truncated_weights_are_refused(weights, share):
    path, _ = weights
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InvalidResultError, match=r"weights\.safetensors: not a whole"):
        load_weights(path)


def test_weights_of_another_preset_are_refused(line, weights):
    path, _ = weights
    with pytest.raises(InvalidResultError, match="another preset"):
        load_weights(path).load_into(line.LineStage(hidden=16).trained)
    with pytest.raises(InvalidResultError, match="lacks"):
        load_weights(path).load_into(
            torch.nn.Sequential(*line.LineStage().trained, torch.nn.PReLU())
        )
    with pytest.raises(InvalidResultError, match="does not know"):
        load_weights(path).load_into(torch.nn.Sequential(torch.nn.Linear(3, 8)))


def test_a_refused_file_changes_nothing(line, weights):
    path, _ = weights
    other = line.LineStage(hidden=16)
    before = {k: v.clone() for k, v in other.trained.state_dict().items()}
    with pytest.raises(InvalidResultError):
        load_weights(path).load_into(other.trained)
    for name, value in other.trained.state_dict().items():
        assert torch.equal(value, before[name])


def test_weights_that_are_no_numbers_are_refused(line, tmp_path):
    stage = line.LineStage()
    with torch.no_grad():
        stage.trained[0].bias[2] = float("nan")
    path = tmp_path / "nan.safetensors"
    save_weights(path, stage.trained.state_dict(), stage.network, kind="towel")
    with pytest.raises(InvalidResultError, match=r"0\.bias is not finite"):
        load_weights(path).load_into(stage.trained)


def test_weights_of_others_are_refused(tmp_path):
    path = tmp_path / "other.safetensors"
    save_file({"a": torch.zeros(2)}, path)
    with pytest.raises(InvalidResultError, match="expected 'clothtrack-weights'"):
        load_weights(path)
    described = {"format": "clothtrack-weights", "version": "1", "kind": "towel"}
    save_file({"a": torch.zeros(2)}, path, {**described, "network": "{", "provenance": "{}"})
    with pytest.raises(InvalidResultError, match="damaged"):
        load_weights(path)
    save_file({"a": torch.zeros(2)}, path, {**described, "network": "3", "provenance": "{}"})
    with pytest.raises(InvalidResultError, match="settings"):
        load_weights(path)
    with pytest.raises(InvalidResultError, match="no such weights"):
        load_weights(tmp_path / "nothing.safetensors")


def test_one_altered_byte_of_weights_is_noticed(weights):
    path, _ = weights
    whole = path.read_bytes()
    for place in range(8, len(whole), 7):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(InvalidResultError, match=r"weights\.safetensors: "):
            load_weights(path)
    path.write_bytes(whole)
    load_weights(path)


def test_weights_from_before_digests_are_read_and_said_to_be(weights, caplog):
    path, stage = weights
    described = {
        "format": "clothtrack-weights", "version": "1", "kind": "towel",
        "network": '{"hidden": 8}', "provenance": "{}",
    }  # fmt: skip
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


def test_progress_comes_back(tmp_path):
    path = tmp_path / "progress.pt"
    document = {"step": 7, "weights": {"a": torch.arange(3.0)}, "data": {"shards": ["x"]}}
    save_progress(path, document)
    found = load_progress(path)
    assert found["step"] == 7
    assert torch.equal(found["weights"]["a"], torch.arange(3.0))
    assert [one.name for one in tmp_path.iterdir()] == ["progress.pt"]


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.98])
def test_truncated_progress_is_refused(tmp_path, share):
    path = tmp_path / "progress.pt"
    save_progress(path, {"step": 7, "weights": {"a": torch.arange(3000.0)}})
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InvalidResultError, match=r"progress\.pt: not the progress"):
        load_progress(path)


def test_progress_of_others_is_refused(tmp_path):
    path = tmp_path / "progress.pt"
    torch.save({"state_dict": torch.zeros(2)}, path)
    with pytest.raises(InvalidResultError, match="not the progress"):
        load_progress(path)
    torch.save({"format": "clothtrack-training-progress", "version": 99}, path)
    with pytest.raises(InvalidResultError, match="version 99"):
        load_progress(path)
    torch.save(torch.zeros(2), path)
    with pytest.raises(InvalidResultError, match="not the progress"):
        load_progress(path)


def test_progress_that_does_not_fit_is_refused(line, tmp_path):
    line.train_line(tmp_path, epochs=1)
    path = tmp_path / "progress.pt"
    document = load_progress(path)
    del document["optimizer"]
    save_progress(path, document)
    with pytest.raises(InvalidResultError, match="does not fit"):
        line.train_line(tmp_path, epochs=1)


def test_a_disk_that_refuses_is_named(line, tmp_path):
    stage = line.LineStage()
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StorageError, match="in the way"):
        save_weights(
            tmp_path / "file" / "weights.safetensors",
            stage.trained.state_dict(),
            stage.network,
            kind="towel",
        )
    with pytest.raises(StorageError, match="in the way"):
        save_progress(tmp_path / "file" / "progress.pt", {"step": 1})


def test_a_killed_write_leaves_the_old_file(line, tmp_path, monkeypatch):
    path = tmp_path / "progress.pt"
    save_progress(path, {"step": 1})

    def fail(*_):
        raise OSError(28, os.strerror(28), str(path))

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(StorageError, match="full"):
        save_progress(path, {"step": 2})
    monkeypatch.undo()
    assert load_progress(path)["step"] == 1
    assert [one.name for one in tmp_path.iterdir()] == ["progress.pt"]


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


def test_the_description_is_plain_text(weights):
    path, _ = weights
    size = int.from_bytes(path.read_bytes()[:8], "little")
    header = json.loads(path.read_bytes()[8 : 8 + size])
    assert header["__metadata__"]["format"] == "clothtrack-weights"
