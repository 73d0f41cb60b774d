"""A training whose rate stays: fed with other examples, averaged, and let fall once at the end."""

import numpy as np
import pytest
import torch

from clothtrack.cli.command_line import main
from clothtrack.errors import InvalidConfigError
from clothtrack.garments.garment_meshes import garment
from clothtrack.reconstruction.data.state_store import StateShard, write_states
from clothtrack.reconstruction.training.checkpoint import load_progress, load_weights
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_loop import train
from clothtrack.reconstruction.training.training_run import PROGRESS

CONFIG = {
    "decay": "stable", "batch_size": 4, "low_rate": 1e-6, "high_rate": 3e-2, "rise_examples": 80,
    "average_examples": 40, "evaluate_examples": 80, "save_steps": 5,
}  # fmt: skip


class EnoughError(Exception):
    """Ends a training that would go on."""


def at(step):
    """A progress that ends the training after a step."""

    def stop(place, done, total):
        assert total == 0
        assert place == f"line: {4 * done} examples"
        if done == step:
            raise EnoughError

    return stop


def learn(line, folder, *, until=None, examples=None, data=None, hours=None, **changes):
    stage = line.LineStage(dropout=0.0)
    outcome = train(
        stage,
        examples or line.LineExamples(),
        line.LineExamples(12, seed=1),
        TrainingConfig(**{**CONFIG, **changes}),
        folder,
        collate=line.line_batch,
        data=data or {"sets": ["first"]},
        progress=None if until is None else at(until),
        hours=hours,
    )
    return stage, outcome


def test_the_rate_rises_stays_and_falls_once():
    config = TrainingConfig(**{**CONFIG, "fall_examples": 400})
    rates = np.array([config.rate(step, 10) for step in range(300)])
    assert rates[0] == pytest.approx(1e-6)
    np.testing.assert_allclose(np.diff(rates[:20]), np.diff(rates[:20])[0])
    np.testing.assert_allclose(rates[20:], 3e-2)
    falling = np.array([config.rate(step, 10, falls_from=100) for step in range(100, 201)])
    assert (np.diff(falling) < 0.0).all()
    assert falling[25] == pytest.approx(0.5 * 3e-2, rel=1e-3)
    assert falling[-1] == pytest.approx(1e-6)


def test_a_killed_run_goes_on_to_the_same_bits(line, tmp_path):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    with pytest.raises(EnoughError):
        learn(line, whole, until=40)
    for step in (23, 40):
        with pytest.raises(EnoughError):
            learn(line, broken, until=step)
    first, second = (load_progress(folder / PROGRESS) for folder in (whole, broken))
    assert first["step"] == second["step"] == 40
    for part in ("weights", "average"):
        for name, value in first[part].items():
            assert torch.equal(value, second[part][name]), (part, name)


def test_what_is_kept_is_the_average_of_the_weights(line, tmp_path):
    with pytest.raises(EnoughError):
        learn(line, tmp_path, until=20)
    progress = load_progress(tmp_path / PROGRESS)
    kept = load_weights(tmp_path / "best.safetensors")
    assert kept.provenance["examples"] == 80
    differs = False
    for name, value in progress["average"].items():
        assert torch.equal(value, kept.tensors[name])
        differs |= not torch.equal(value, progress["weights"][name])
    assert differs


def test_other_examples_begin_another_phase(line, tmp_path):
    with pytest.raises(EnoughError):
        learn(line, tmp_path, until=25)
    more = line.LineExamples(60, seed=3)
    with pytest.raises(EnoughError):
        learn(line, tmp_path, until=50, examples=more, data={"sets": ["first", "second"]})
    phases = load_progress(tmp_path / PROGRESS)["phases"]
    # 25 steps of ten an epoch: the third epoch was begun, the next phase begins with the fourth.
    assert [(one["from_step"], one["first_epoch"]) for one in phases] == [(0, 0), (25, 3)]
    assert [one["examples"] for one in phases] == [40, 60]
    kept = load_weights(tmp_path / "best.safetensors").provenance
    assert [one["data"] for one in kept["phases"]] == [one["data"] for one in phases]
    # The same examples again are no other phase.
    with pytest.raises(EnoughError):
        learn(line, tmp_path, until=55, examples=more, data={"sets": ["first", "second"]})
    assert len(load_progress(tmp_path / PROGRESS)["phases"]) == 2


def test_time_that_is_over_pauses_and_fall_ends_the_run(line, tmp_path):
    _, paused = learn(line, tmp_path, hours=1e-9)
    assert (paused.status, paused.steps) == ("paused", 1)
    _, ended = learn(line, tmp_path, fall_examples=200)
    assert (ended.status, ended.steps) == ("finished", 51)
    with pytest.raises(InvalidConfigError, match="falls since step 1; give the fall_examples"):
        learn(line, tmp_path, hours=1e-9)


def test_a_training_that_nothing_ends_is_refused(tmp_path, capsys):
    mesh = garment("towel", vertex_count=100)
    positions = np.asarray(mesh.vertices, np.float32)[None]
    shard = StateShard("towel", mesh, positions, np.zeros(1, np.int64), ("flat",), 0)
    write_states(tmp_path / "states", "towel", [shard], {})
    command = ["pretrain", str(tmp_path / "states"), "--output", str(tmp_path / "run")]
    assert main(command) == 1
    said = capsys.readouterr().err
    assert "add --hours N, or --set tokens.fall_examples=N" in said
    assert not (tmp_path / "run").exists()
    assert main([*command, "--hours", "1", "--network", "small"]) == 1
    assert "--hours: a published network learns for its epochs" in capsys.readouterr().err
