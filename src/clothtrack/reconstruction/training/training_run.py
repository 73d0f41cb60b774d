"""The state of a training: its steps, the average of its weights, saving and resuming."""

import logging
import math
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from clothtrack.errors import InvalidConfigError, InvalidResultError, StorageError
from clothtrack.files.provenance import as_plain, require_same
from clothtrack.reconstruction.training.batches import BatchOrder
from clothtrack.reconstruction.training.checkpoint import (
    load_progress,
    load_tensors,
    save_progress,
    save_weights,
    without_start,
)
from clothtrack.reconstruction.training.stage import Stage
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_log import TrainingLog

logger = logging.getLogger(__name__)

PROGRESS = "progress.pt"
WEIGHTS = "best.safetensors"
_MAY_CHANGE = (
    "epochs", "patience", "log_steps", "save_steps", "workers", "evaluate_examples", "fall_examples"
)  # fmt: skip
"""Settings that may differ in a resumed run, because the steps done so far do not depend on
them."""

Status = Literal["finished", "converged", "paused", "interrupted"]


@dataclass(frozen=True)
class TrainingOutcome:
    """Outcome of a run.

    Attributes:
        status: "finished" (all epochs or the fall of the rate), "converged" (no more improvement),
            "paused" (time limit reached) or "interrupted".
        best_step: number of steps after which it was reached.
        weights: file with the weights of that step; None if nothing was measured yet.
        cpu_s: CPU time of this process and of the runs that it resumes [s].
    """

    status: Status
    steps: int
    best_score: float
    best_step: int
    weights: Path | None
    cpu_s: float = 0.0
    unit: str = "mm"


class TrainingRun:
    """State of a stage's training, with saving and resuming.

    Attributes:
        is_judged: whether the weights were measured after the last step.
        averaged: stage that is measured and saved: with averaged weights, or the stage itself.
        phases: training data and first step of each phase; more than one if examples were changed.

    Args:
        order: order of its examples; the start of the last phase is set on it.
    """

    def __init__(
        self,
        stage: Stage,
        order: BatchOrder,
        config: TrainingConfig,
        folder: Path,
        data: Mapping[str, Any],
    ) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError.of(error) from error
        self.stage, self.config, self.folder = stage, config, folder
        self.order, self.processes = order, order.processes
        self.phases: list[dict[str, Any]] = [
            {"from_step": 0, "first_epoch": 0, "examples": order.count, "data": as_plain(data)}
        ]
        self.falls_from: int | None = None
        self.step, self.best_score, self.best_step, self.stale = 0, float("inf"), 0, 0
        self.is_judged = False
        self._clock = time.process_time()
        chosen = [one for one in stage.trained.parameters() if one.requires_grad]
        self.optimizer = torch.optim.Adam(chosen, lr=config.low_rate, fused=True)
        self._average = None
        if config.average_examples:
            kept = math.exp(-order.size / config.average_examples)
            self._average = AveragedModel(
                stage, multi_avg_fn=get_ema_multi_avg_fn(kept), use_buffers=True
            )
        alone = self.processes.count == 1
        self.model = stage if alone else DistributedDataParallel(stage)
        # From here on each process has its own random numbers, which are the same in every run.
        torch.manual_seed(config.seed * 1_000_003 + self.processes.rank)

    @property
    def cpu_s(self) -> float:
        """CPU time [s] of all runs of this training."""
        return time.process_time() - self._clock

    @property
    def averaged(self) -> Stage:
        """Stage that is measured and saved: with averaged weights, or the stage itself."""
        return self.stage if self._average is None else cast("Stage", self._average.module)

    @property
    def is_to_be_judged(self) -> bool:
        """Whether a measurement is due."""
        if self.config.decay == "stable":
            every = max(1, self.config.evaluate_examples // self.order.size)
            return self.step % every == 0 or self.step == self.order.steps
        return self.step % (self.config.evaluate_epochs * self.order.steps_per_epoch) == 0

    @property
    def place(self) -> str:
        """Progress of the run, in words."""
        if self.order.steps == sys.maxsize:
            return f"{self.stage.name}: {self.step * self.order.size} examples"
        return f"{self.stage.name}: step {self.step}/{self.order.steps}"

    @property
    def converged(self) -> bool:
        """Whether patience has run out."""
        return 0 < self.config.patience <= self.stale

    def advance(self, batch: Any) -> Mapping[str, Tensor]:
        """Do one step of Adam and return the scalars of its batch."""
        self.stage.train()
        rate = self.config.rate(self.step, self.order.steps_per_epoch, falls_from=self.falls_from)
        if self.config.freeze_statistics:
            freeze_statistics(self.stage)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        device = self.processes.device
        with torch.autocast(device.split(":")[0], torch.bfloat16, enabled=self.config.bfloat16):
            scalars = self.model(batch.to(device))
        if not np.isfinite(loss := float(scalars["loss"].detach())):
            # Checked before the weights change, so the last progress on disk stays valid.
            raise InvalidConfigError(
                f"the loss of {self.stage.name} is {loss} after step {self.step}; lower high_rate "
                f"({self.config.high_rate}) and start again from the last progress"
            )
        self.optimizer.zero_grad(set_to_none=True)
        scalars["loss"].backward()
        if self.config.gradient_limit:
            nn.utils.clip_grad_norm_(self.stage.trained.parameters(), self.config.gradient_limit)
        self.optimizer.step()
        self.step += 1
        self.is_judged = False
        if self._average is not None:
            self._average.update_parameters(self.stage)
            for mean, now in zip(self._average.module.buffers(), self.stage.buffers(), strict=True):
                if not now.is_floating_point():
                    mean.copy_(now)
        return {"rate": torch.tensor(rate), **scalars}

    def note(self, scalars: Mapping[str, Tensor], log: TrainingLog | None) -> None:
        """Write the scalars of a step, if it is a logged step."""
        if log is not None and (self.step % self.config.log_steps == 0 or self.step == 1):
            values = {name: float(value.detach()) for name, value in scalars.items()}
            log.write("train", self.step, self.order.epoch(self.step - 1), values)

    def judge(self, measures: Mapping[str, float], log: TrainingLog | None) -> None:
        """Save the weights if they are the best so far; save the progress in any case."""
        self.is_judged = True
        score = measures[self.stage.score]
        if score < self.best_score:
            self.best_score, self.best_step, self.stale = score, self.step, 0
            if self.processes.writes:
                self._share(measures)
        else:
            self.stale += 1
        if log is not None:
            log.write("held_out", self.step, self.order.epoch(max(0, self.step - 1)), measures)
        self.save()

    def _share(self, measures: Mapping[str, float]) -> None:
        provenance: dict[str, Any] = {
            "stage": self.stage.name,
            "step": self.step,
            "held_out": dict(measures),
            "examples": self.step * self.order.size,
            "training": asdict(self.config),
            "data": self.phases[-1]["data"],
        }
        if len(self.phases) > 1:
            provenance["phases"] = [
                {**phase, "data": without_start(phase["data"])} for phase in self.phases
            ]
        save_weights(
            self.folder / WEIGHTS,
            self.averaged.trained.state_dict(),
            self.stage.network,
            kind=self.stage.kind,
            provenance=provenance,
        )

    def save(self) -> None:
        """Write everything that the next step depends on."""
        generators = self.processes.gathered([torch.get_rng_state()])
        if self.processes.writes:
            document = {
                **self._identity(),
                "step": self.step,
                "best_score": self.best_score,
                "best_step": self.best_step,
                "stale": self.stale,
                "phases": self.phases,
                "falls_from": self.falls_from,
                "average": None if self._average is None else self.averaged.trained.state_dict(),
                "weights": self.stage.trained.state_dict(),
                "optimizer": self.optimizer.state_dict(),
                "generators": generators,
                "cpu_s": self.cpu_s,
            }
            save_progress(self.folder / PROGRESS, document)
        self.processes.wait()

    def resume(self) -> None:
        """Resume from the progress in the folder, if there is any."""
        path = self.folder / PROGRESS
        if not path.exists():
            return
        document = load_progress(path)
        identity = self._identity()
        # Sizes by level are tuples in the progress, and lists in the identity to compare with.
        stored = as_plain({name: document.get(name) for name in identity})
        require_same(path, stored, identity)
        try:
            load_tensors(self.stage.trained, document["weights"], path)
            self.optimizer.load_state_dict(document["optimizer"])
            self.step, self.stale = document["step"], document["stale"]
            self.best_score, self.best_step = document["best_score"], document["best_step"]
            generators = document["generators"]
            torch.set_rng_state(generators[self.processes.rank % len(generators)])
            self._clock -= float(document.get("cpu_s", 0.0))
            self.falls_from = document["falls_from"]
            self._go_on_from(document["phases"])
            if self._average is not None:
                load_tensors(self.averaged.trained, document["average"], path)
                # The first update of a new average would copy the weights over it.
                self._average.n_averaged.fill_(max(1, self.step))
        except (KeyError, ValueError, TypeError, RuntimeError, IndexError) as error:
            raise InvalidResultError(
                f"{path}: its content does not fit ({error}); remove it to train from the start"
            ) from error
        logger.info("%s: going on after step %d", path, self.step)

    def _go_on_from(self, phases: list[dict[str, Any]]) -> None:
        """Continue the last phase, or begin a new one if the examples have changed."""
        now, last = self.phases[0], phases[-1]
        per_epoch = last["examples"] // self.order.size
        if now["data"] == last["data"]:
            self.phases, self.is_judged = phases, True
        else:
            begun = -(-(self.step - last["from_step"]) // per_epoch)
            epoch = last["first_epoch"] + begun
            self.phases = [*phases, {**now, "from_step": self.step, "first_epoch": epoch}]
            # Other examples are held out, so the best score on the old ones is not comparable.
            self.best_score, self.stale = float("inf"), 0
            logger.info("%s: other examples from step %d on", self.folder, self.step)
        self.order.from_step = self.phases[-1]["from_step"]
        self.order.first_epoch = self.phases[-1]["first_epoch"]

    def plan_fall(self) -> None:
        """Start the fall of a "stable" rate at this step, if it is requested."""
        if self.config.decay != "stable":
            return
        if self.config.fall_examples:
            start = self.step if self.falls_from is None else self.falls_from
            self.falls_from = start
            self.order.steps = start + -(-self.config.fall_examples // self.order.size)
        elif self.falls_from is not None:
            raise InvalidConfigError(
                f"{self.folder}: its rate falls since step {self.falls_from}; give the "
                "fall_examples that it began with, or start another run from its weights"
            )

    def _identity(self) -> dict[str, Any]:
        training = {k: v for k, v in asdict(self.config).items() if k not in _MAY_CHANGE}
        return {
            "stage": self.stage.name,
            "kind": self.stage.kind,
            "network": asdict(self.stage.network),
            "training": training,
            # A run with a "stable" rate may be resumed with other examples.
            "data": None if self.config.decay == "stable" else self.phases[-1]["data"],
        }

    def outcome(self, status: Status) -> TrainingOutcome:
        """Return the outcome of the run."""
        weights = self.folder / WEIGHTS
        best = weights if np.isfinite(self.best_score) else None
        return TrainingOutcome(
            status,
            self.step,
            self.best_score,
            self.best_step,
            best,
            self.cpu_s,
            self.stage.unit,
        )


def freeze_statistics(module: nn.Module) -> None:
    """Make batch norms use their current mean and variance without updating them."""
    for part in module.modules():
        if isinstance(part, nn.modules.batchnorm._BatchNorm):
            part.eval()
