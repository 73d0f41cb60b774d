"""A stage small enough to be trained a hundred times while the tests run."""

import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn

from clothtrack.reconstruction.training.processes import joined
from clothtrack.reconstruction.training.stage import Stage
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_loop import train


@dataclass(frozen=True)
class LineConfig:
    hidden: int = 8


class LineBatch:
    def __init__(self, inputs, targets):
        self.inputs = inputs
        self.targets = targets

    def to(self, device):
        return LineBatch(self.inputs.to(device), self.targets.to(device))


class LineExamples:
    """Noisy points of a plane; the noise is drawn anew for each epoch."""

    def __init__(self, count=40, seed=0):
        self.count = count
        self.seed = seed

    def __len__(self):
        return self.count

    def __getitem__(self, draw):
        index, epoch = draw
        point = np.random.default_rng([self.seed, index]).standard_normal(3)
        noise = 0.01 * np.random.default_rng([self.seed, epoch, index]).standard_normal()
        target = point @ (0.5, -1.0, 2.0) + noise
        return torch.tensor(point, dtype=torch.float32), torch.tensor([target]).float()


def line_batch(examples):
    inputs, targets = zip(*examples, strict=True)
    return LineBatch(torch.stack(inputs), torch.stack(targets))


class LineStage(Stage):
    """Batch norm and dropout: whatever a resumed run could forget."""

    name = "line"
    score = "error"
    kind = "towel"

    def __init__(self, hidden=8, seed=0, dropout=0.1):
        super().__init__()
        torch.manual_seed(seed)
        self.network = LineConfig(hidden)
        self.trained = nn.Sequential(
            nn.Linear(3, hidden),
            nn.BatchNorm1d(hidden),
            nn.ReLU(),
            nn.Dropout(dropout),
            nn.Linear(hidden, 1),
        )

    def forward(self, batch):
        return {"loss": ((self.trained(batch.inputs) - batch.targets) ** 2).mean()}

    def measure(self, batch):
        return {"error": (self.trained(batch.inputs) - batch.targets).abs()[:, 0]}


def train_line(folder, *, kill_after=0, processes=None, dropout=0.1, **settings):
    """Train the toy; kill this very process, as a power cut would, after some steps."""
    config = TrainingConfig(
        **{"epochs": 4, "batch_size": 4, "log_steps": 1, "save_steps": 3, **settings}
    )

    def progress(name, done, total):
        if done == kill_after:
            os.kill(os.getpid(), signal.SIGKILL)

    stage = LineStage(dropout=dropout)
    outcome = train(
        stage,
        LineExamples(),
        LineExamples(12, seed=1),
        config,
        Path(folder),
        collate=line_batch,
        processes=processes,
        progress=progress,
    )
    return stage, outcome


if __name__ == "__main__":
    torch.set_num_threads(1)
    with joined("cpu") as together:
        # Dropout draws its own numbers in each process and batch norm sees only its share of a
        # batch: without the two the number of processes makes no difference.
        train_line(
            sys.argv[1],
            kill_after=int(sys.argv[2]),
            processes=together,
            dropout=float(sys.argv[3]),
            freeze_statistics=float(sys.argv[3]) == 0.0,
        )
