"""Training of the mesh dynamics on roll-outs, with the package's common training loop.

Noise on the past teaches the model to correct its own errors, and a loss over several of its own
steps teaches it not to accumulate them. The reference has neither (method notes, Sec. 6.1).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Checked, Count
from clothtrack.files.progress import Progress
from clothtrack.reconstruction.training.batches import Draw, Subset, split_by_group
from clothtrack.reconstruction.training.stage import Stage
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_loop import train
from clothtrack.reconstruction.training.training_run import TrainingOutcome
from clothtrack.simulation.parameters import RESTING_HEIGHT_M
from clothtrack_lab.graph_dynamics.mesh_dynamics import springs_of
from clothtrack_lab.graph_dynamics.mesh_network import (
    MeshNetwork,
    MeshNetworkConfig,
    Ways,
    advance,
    roll_out,
)
from clothtrack_lab.graph_dynamics.mesh_prior import Springs
from clothtrack_lab.graph_dynamics.roll_outs import RollOutShard, read_roll_outs

_TINY = 1e-12
"""Added under the square root of distances, which has no gradient at 0."""


@dataclass(frozen=True)
class DynamicsTrainingConfig(Checked):
    """The training configuration of the mesh dynamics.

    Attributes:
        network: sizes of the graph network.
        loop: epochs, rates and seed; for the batch size see `windows`.
        windows: number of windows of one garment per example; with a loop's batch size of 1 they
            are the batch (reference: 16).
        unrolled: number of the model's own steps in the loss; 6 of 0.2 s are a whole roll-out, 1 is
            the reference's one-step loss.
        noise_m: standard deviation of the random walk added to the past, at its end [m].
        examples_per_shard: number of examples that an epoch draws from each shard.
    """

    network: MeshNetworkConfig = field(default_factory=MeshNetworkConfig)
    loop: TrainingConfig = field(
        default_factory=lambda: TrainingConfig(
            epochs=100, batch_size=1, low_rate=1e-4, high_rate=1e-4, save_steps=200
        )
    )
    windows: Count = 16
    unrolled: Count = 6
    noise_m: float = 0.003
    examples_per_shard: Count = 20


@dataclass(frozen=True, eq=False)
class Windows:
    """Short sections of roll-outs of one garment.

    Attributes:
        past: noisy positions before and at the start (windows, history + 1, vertices, 3) [m].
        future: true positions after it (windows, unrolled, vertices, 3) [m].
        held: whether each vertex is held during each future step (windows, unrolled, vertices).
    """

    past: Tensor
    future: Tensor
    held: Tensor
    springs: Springs

    def to(self, device: str) -> "Windows":
        """Return a copy on a device."""
        return Windows(
            self.past.to(device), self.future.to(device), self.held.to(device),
            self.springs.to(device),
        )  # fmt: skip


class WindowExamples:
    """A dataset of roll-out windows; shards are read on demand, and the latest is cached."""

    def __init__(
        self, shards: Sequence[Path], config: DynamicsTrainingConfig, *, noisy: bool = True
    ) -> None:
        """Store the paths of the shards."""
        if not shards:
            raise InvalidConfigError("no shard of roll-outs is given; make some first")
        self.shards, self.config, self.noisy = list(shards), config, noisy
        self._kept: dict[int, tuple[RollOutShard, Springs]] = {}

    @property
    def groups(self) -> list[int]:
        """The shard of each example."""
        per = self.config.examples_per_shard
        return [number for number in range(len(self.shards)) for _ in range(per)]

    def __len__(self) -> int:
        """Return the number of examples per epoch."""
        return len(self.shards) * self.config.examples_per_shard

    def __getitem__(self, draw: Draw) -> Windows:
        """Return windows of one garment, randomly rotated about the vertical."""
        index, epoch = draw
        config, history = self.config, self.config.network.history
        shard, springs = self._shard(index // config.examples_per_shard)
        rng = np.random.default_rng([config.loop.seed, epoch, index, int(self.noisy)])
        rolls, frames = shard.positions.shape[:2]
        roll = rng.integers(rolls, size=config.windows)
        # Half of the windows begin while something is held, because most of a roll-out is calm.
        last = np.maximum(frames - 1 - config.unrolled, 0)
        ends = np.where(rng.random(config.windows) < 0.5, shard.held_frames[roll], last + 1)
        start = (rng.random(config.windows) * np.clip(ends, 1, last + 1)).astype(int)
        # Before the first moment the cloth was at rest.
        times = np.clip(start[:, None] + np.arange(-history, 1 + config.unrolled), 0, frames - 1)
        moments = shard.positions[roll[:, None], times].astype(np.float64)
        moments = _turned(moments, rng)
        past, future = moments[:, : history + 1], moments[:, history + 1 :]
        if self.noisy:
            walk = rng.standard_normal(past.shape) * config.noise_m / np.sqrt(history + 1)
            past = past + walk.cumsum(axis=1)
        held = np.zeros(future.shape[:3], dtype=bool)
        at = start[:, None] + np.arange(config.unrolled)
        windows, steps = np.nonzero(at < shard.held_frames[roll][:, None])
        held[windows, steps, shard.held[roll][windows]] = True
        as_tensor = torch.tensor
        return Windows(
            as_tensor(past, dtype=torch.float32), as_tensor(future, dtype=torch.float32),
            as_tensor(held), springs,
        )  # fmt: skip

    def _shard(self, number: int) -> tuple[RollOutShard, Springs]:
        if number not in self._kept:
            if len(self._kept) >= 64:
                self._kept.pop(next(iter(self._kept)))
            shard = read_roll_outs(self.shards[number]).every(self.config.network.step_s)
            self._kept[number] = shard, springs_of(shard.mesh)
        return self._kept[number]


def _turned(moments: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return each window rotated about the vertical or mirrored at random, as augmentation."""
    angle = rng.uniform(0.0, 2.0 * np.pi, len(moments))
    mirror = np.where(rng.random(len(moments)) < 0.5, -1.0, 1.0)
    turn = np.array(
        [[np.cos(angle), -mirror * np.sin(angle)], [np.sin(angle), mirror * np.cos(angle)]]
    ).transpose(2, 0, 1)
    turned = moments.copy()
    turned[..., :2] = np.einsum("wij,wtvj->wtvi", turn, moments[..., :2])
    return turned


@dataclass(frozen=True, eq=False)
class WindowBatch:
    """A batch of examples, possibly of different garments."""

    parts: Sequence[Windows]

    def to(self, device: str) -> "WindowBatch":
        """Return a copy on a device."""
        return WindowBatch([one.to(device) for one in self.parts])


class MeshDynamicsStage(Stage):
    """The mesh dynamics as a stage of the training loop."""

    name = "mesh_dynamics"
    score = "error_mm"

    def __init__(self, config: DynamicsTrainingConfig, kind: str) -> None:
        """Initialize the weights from the seed."""
        super().__init__()
        torch.manual_seed(config.loop.seed)
        self.kind = kind
        self.network = config.network
        self.trained = MeshNetwork(config.network)

    def forward(self, batch: WindowBatch) -> Mapping[str, Tensor]:
        """Return the loss: mean distance of predicted and true positions.

        The distance is not squared, because whether a cloth slips or keeps hanging is
        unpredictable, and then the error is large.
        """
        losses = []
        for windows in batch.parts:
            error = self._unrolled(windows) - windows.future
            scale = self.network.step_s * self.network.velocity_scale
            losses.append((error / scale).square().sum(dim=-1).add(_TINY).sqrt().mean())
        return {"loss": torch.stack(losses).mean()}

    def measure(self, batch: WindowBatch) -> Mapping[str, Tensor]:
        """Return the mean distance to the truth, by the model and without motion [mm]."""
        errors, still = [], []
        for windows in batch.parts:
            last = windows.future[:, -1]
            gap = (self._unrolled(windows)[:, -1] - last).norm(dim=-1)
            errors.append(1e3 * gap.mean())
            still.append(1e3 * (windows.past[:, -1] - last).norm(dim=-1).mean())
        return {"error_mm": torch.stack(errors), "still_mm": torch.stack(still)}

    def _unrolled(self, windows: Windows) -> Tensor:
        """Return the model's positions after each step (windows, unrolled, vertices, 3)."""
        step_s = self.network.step_s
        positions = windows.past[:, -1]
        velocities = (windows.past.diff(dim=1) / step_s).transpose(1, 2)
        own = []
        for step in range(windows.future.shape[1]):
            positions, velocities = advance(
                self.trained, positions, velocities, windows.held[:, step], windows.springs,
                targets=windows.future[:, step], lowest_m=RESTING_HEIGHT_M,
            )  # fmt: skip
            own.append(positions)
        return torch.stack(own, dim=1)


def train_mesh_dynamics(
    shards: Sequence[Path],
    kind: str,
    config: DynamicsTrainingConfig,
    folder: Path,
    *,
    device: str = "cpu",
    progress: Progress | None = None,
) -> TrainingOutcome:
    """Train mesh dynamics on roll-outs, or resume an earlier run."""
    examples = WindowExamples(shards, config)
    calm = WindowExamples(shards, config, noisy=False)
    chosen, held_out = split_by_group(examples.groups, config.loop.held_out_share, config.loop.seed)
    data: dict[str, Any] = {
        "shards": len(examples.shards),
        "roll_outs": sum(len(read_roll_outs(path).positions) for path in shards),
        "windows": config.windows,
        "unrolled": config.unrolled,
        "noise_m": config.noise_m,
        "examples_per_shard": config.examples_per_shard,
    }
    return train(
        MeshDynamicsStage(config, kind).to(device),
        Subset(examples, chosen),
        Subset(calm, held_out),
        config.loop,
        folder,
        collate=WindowBatch,
        data=data,
        progress=progress,
    )


def whole_roll_outs(
    network: MeshNetwork, shards: Sequence[Path], *, device: str = "cpu"
) -> Mapping[str, float]:
    """Return the mean distances to the simulator at the end of whole roll-outs, by name [mm]."""
    ends, still = [], []
    for path in shards:
        shard = read_roll_outs(path).every(network.config.step_s)
        positions = torch.tensor(shard.positions, device=device)
        taken = torch.tensor(shard.held, device=device)
        every = torch.arange(len(positions), device=device)
        places = positions[every, 1:, taken.clamp_min(0)]
        ways = Ways(taken, places, torch.tensor(shard.held_frames, device=device))
        last = positions[:, -1]
        own = roll_out(
            network, positions[:, 0], springs_of(shard.mesh).to(device), ways,
            steps=places.shape[1], lowest_m=RESTING_HEIGHT_M,
        )  # fmt: skip
        ends.append((own - last).norm(dim=-1).mean(dim=1))
        still.append((positions[:, 0] - last).norm(dim=-1).mean(dim=1))
    return {
        "whole_error_mm": 1e3 * float(torch.cat(ends).mean()),
        "whole_still_mm": 1e3 * float(torch.cat(still).mean()),
    }
