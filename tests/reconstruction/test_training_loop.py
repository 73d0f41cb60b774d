"""The loop: it learns, selects, resumes to the same bits, and says what is wrong."""

import json
import os
import platform
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.reconstruction.training.batches import BatchOrder
from clothtrack.reconstruction.training.checkpoint import load_progress, load_weights, save_progress
from clothtrack.reconstruction.training.processes import Processes, require_torch_device
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_log import read_scalars
from clothtrack.reconstruction.training.training_loop import train
from clothtrack.reconstruction.training.training_run import PROGRESS

SCRIPT = Path(__file__).with_name("line_stage.py")
STEPS = 40


def in_a_process(folder, *, kill_after=0, dropout=0.1, launcher=()):
    """Train the toy in a process of its own; returns its exit status."""
    command = [sys.executable, *launcher, str(SCRIPT), str(folder), str(kill_after), str(dropout)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode in (0, -signal.SIGKILL), done.stderr
    return done.returncode


def progress_of(folder):
    return load_progress(folder / PROGRESS)


def assert_same_bits(first, second):
    assert first.keys() == second.keys()
    for name, value in first.items():
        assert torch.equal(value, second[name]), name


def without_time(folder):
    return [json.dumps(line, sort_keys=True) for line in read_scalars(folder)]


@pytest.mark.slow
def test_training_learns_and_keeps_the_best(line, tmp_path):
    _, outcome = line.train_line(tmp_path, epochs=60, high_rate=1e-2, low_rate=1e-2)
    held = [one["error"] for one in read_scalars(tmp_path) if one["split"] == "held_out"]
    assert outcome.status == "finished"
    assert outcome.steps == 600
    assert outcome.best_score == min(held) < 0.4 * held[0]
    best = line.LineStage(seed=5)
    load_weights(outcome.weights).load_into(best.trained)
    best.eval()
    batch = line.line_batch([line.LineExamples(12, seed=1)[k, 0] for k in range(12)])
    with torch.no_grad():
        assert best.measure(batch)["error"].mean() == pytest.approx(outcome.best_score, abs=1e-6)


def test_a_training_that_was_never_measured_is_no_interrupted_one(line, tmp_path, monkeypatch):
    monkeypatch.setattr(
        line.LineStage, "measure", lambda self, batch: {"error": batch.targets[:, 0] * np.nan}
    )
    for _ in range(2):
        with pytest.raises(InvalidResultError, match="no weights came of 40 steps, error"):
            line.train_line(tmp_path)


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_bits(line, tmp_path):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    line.train_line(whole)
    # Between two saves, so that work is lost and done again.
    assert in_a_process(broken, kill_after=17) == -signal.SIGKILL
    assert 0 < progress_of(broken)["step"] < 17
    line.train_line(broken)
    first, second = progress_of(whole), progress_of(broken)
    assert first["step"] == second["step"] == STEPS
    assert_same_bits(first["weights"], second["weights"])
    for number, state in first["optimizer"]["state"].items():
        assert_same_bits(state, second["optimizer"]["state"][number])
    best = [load_weights(folder / "best.safetensors").tensors for folder in (whole, broken)]
    assert_same_bits(*best)
    assert without_time(whole) == without_time(broken)


@pytest.mark.slow
def test_two_trainings_in_one_folder_do_the_work_once(line, tmp_path):
    whole, shared = tmp_path / "whole", tmp_path / "shared"
    line.train_line(whole)
    said = []

    def try_meanwhile(name, done, total):
        if done == STEPS // 2:
            command = [sys.executable, str(SCRIPT), str(shared), "0", "0.1"]
            said.append(subprocess.run(command, capture_output=True, text=True, check=False))

    run(line, shared, progress=try_meanwhile)
    (second,) = said
    assert second.returncode == 1
    assert f"another run writes here (process {os.getpid()} on {platform.node()})" in second.stderr
    assert_same_bits(progress_of(whole)["weights"], progress_of(shared)["weights"])


@pytest.mark.slow
def test_two_processes_train_as_one(line, tmp_path):
    alone, together = tmp_path / "alone", tmp_path / "together"
    launcher = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2")
    assert in_a_process(alone, dropout=0.0) == 0
    assert in_a_process(together, dropout=0.0, launcher=launcher) == 0
    first, second = progress_of(alone), progress_of(together)
    assert second["step"] == STEPS
    for name, value in first["weights"].items():
        torch.testing.assert_close(second["weights"][name], value, rtol=1e-4, atol=1e-6)
    assert not torch.equal(first["weights"]["0.weight"], line.LineStage().trained[0].weight)
    steps = [one["step"] for one in read_scalars(together) if one["split"] == "train"]
    assert steps == list(range(1, STEPS + 1))


def test_termination_saves_and_the_next_run_goes_on(line, tmp_path):
    def ask_to_stop(name, done, total):
        if done == 7:
            os.kill(os.getpid(), signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    stopped = run(line, tmp_path / "stopped", progress=ask_to_stop)
    assert (stopped.status, stopped.steps) == ("interrupted", 7)
    assert signal.getsignal(signal.SIGTERM) is before
    resumed, through = line.LineStage(seed=9), line.LineStage()
    finished = run(line, tmp_path / "stopped", stage=resumed)
    assert (finished.status, finished.steps) == ("finished", STEPS)
    run(line, tmp_path / "through", stage=through)
    assert_same_bits(resumed.trained.state_dict(), through.trained.state_dict())


def test_a_finished_run_is_not_done_again(line, tmp_path):
    line.train_line(tmp_path)
    before = (tmp_path / "best.safetensors").stat().st_mtime_ns, without_time(tmp_path)
    _, again = line.train_line(tmp_path)
    assert again.status == "finished"
    assert before == ((tmp_path / "best.safetensors").stat().st_mtime_ns, without_time(tmp_path))
    _, longer = line.train_line(tmp_path, epochs=5)
    assert longer.steps == 50


def test_progress_of_other_settings_is_refused(line, tmp_path):
    line.train_line(tmp_path, epochs=1)
    for name, value in {"batch_size": 8, "seed": 1, "low_rate": 1e-4}.items():
        with pytest.raises(InvalidConfigError, match=f"training.{name}"):
            line.train_line(tmp_path, epochs=1, **{name: value})
    progress = progress_of(tmp_path)
    del progress["optimizer"]
    save_progress(tmp_path / PROGRESS, progress)
    with pytest.raises(InvalidResultError, match="does not fit"):
        line.train_line(tmp_path, epochs=1)


def test_training_that_helps_nothing_changes_nothing(line, tmp_path):
    """The start is judged too, and kept when no step beats it."""
    _, outcome = line.train_line(
        tmp_path, epochs=2, low_rate=100.0, high_rate=100.0, freeze_statistics=True
    )
    assert outcome.best_step == 0
    kept = load_weights(outcome.weights).tensors
    assert_same_bits(kept, line.LineStage().trained.state_dict())


def test_an_epoch_shows_everything_once_and_an_order_begun_later_is_its_rest():
    config = TrainingConfig(epochs=3, batch_size=4)
    whole, rest = (BatchOrder(12, config, Processes()) for _ in range(2))
    batches = list(whole)
    epochs = [[draw for batch in batches[3 * k : 3 * k + 3] for draw in batch] for k in range(3)]
    for number, epoch in enumerate(epochs):
        assert sorted(epoch) == [(index, number) for index in range(12)]
    for one, other in pairwise(epochs):
        assert [k for k, _ in one] != [k for k, _ in other]
    rest.start = 5
    assert list(rest) == batches[5:]
    assert len(rest) == len(batches) - 5


def test_processes_share_a_batch():
    config = TrainingConfig(epochs=1, batch_size=4)
    whole = list(BatchOrder(8, config, Processes()))
    shares = [list(BatchOrder(8, config, Processes(rank, 2))) for rank in (0, 1)]
    for batch, *parts in zip(whole, *shares, strict=True):
        assert sorted(batch) == sorted([*parts[0], *parts[1]])
    with pytest.raises(InvalidConfigError, match="multiple"):
        BatchOrder(8, config, Processes(0, 3))


def test_a_loss_that_is_no_number_never_reaches_the_weights(line, tmp_path):
    """It is noticed in its own step, not when a line of scalars is due."""
    stage = line.LineStage()
    ruined = {"at": 7}

    class Ruined(line.LineExamples):
        def __getitem__(self, draw):
            ruined["at"] -= 1
            inputs, targets = super().__getitem__(draw)
            return inputs, targets * (float("nan") if ruined["at"] < 0 else 1.0)

    with pytest.raises(InvalidConfigError, match="loss of line is nan after step 1; lower"):
        run(line, tmp_path, stage=stage, examples=Ruined(), log_steps=1000, save_steps=1)
    saved = progress_of(tmp_path)
    assert saved["step"] == 1
    for one in (*stage.trained.parameters(), *saved["weights"].values()):
        assert torch.isfinite(one).all()


def test_a_run_killed_before_its_first_save_is_judged_once(line, tmp_path):
    """Judged twice, it would seem to have waited a measurement longer for an improvement."""

    def kill(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(line, tmp_path, progress=kill, epochs=1)
    assert (progress_of(tmp_path)["step"], progress_of(tmp_path)["stale"]) == (0, 0)
    run(line, tmp_path, epochs=1)
    assert [row["step"] for row in read_scalars(tmp_path) if row["split"] == "held_out"] == [0, 10]


def run(line, folder, *, stage=None, examples=None, progress=None, **settings):
    """Train one more stage in a folder."""
    config = TrainingConfig(**{"epochs": 4, "batch_size": 4, **settings})
    stage = stage or line.LineStage()
    parts = (stage, examples or line.LineExamples(), line.LineExamples(12, seed=1), config, folder)
    return train(*parts, collate=line.line_batch, progress=progress)


@pytest.mark.parametrize("device", ["tpu", "cuda:x", "cudafast", "cuda:2"])
def test_a_device_that_cannot_be_is_refused(device, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    require_torch_device("cuda:1")
    told = "sees 2 GPUs" if device == "cuda:2" else "use cpu, cuda or cuda:0"
    with pytest.raises(InvalidConfigError, match=told):
        require_torch_device(device)
