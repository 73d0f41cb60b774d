"""The training loop: one for both stages, resumable to the same bits, under torchrun or alone."""

import logging
import signal
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from clothtrack.errors import InvalidConfigError, InvalidResultError, StorageError
from clothtrack.files.progress import Progress
from clothtrack.files.run_manifest import require_same
from clothtrack.files.work_folder import WorkFolder
from clothtrack.reconstruction.training.batches import BatchOrder, Draw, Examples, loader
from clothtrack.reconstruction.training.checkpoint import (
    load_progress,
    load_tensors,
    save_progress,
    save_weights,
)
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_log import TrainingLog

logger = logging.getLogger(__name__)

PROGRESS = "progress.pt"
WEIGHTS = "best.safetensors"
_MAY_CHANGE = ("epochs", "patience", "log_steps", "save_steps", "workers")
"""Settings that a resumed run may have otherwise: what was done so far does not depend on them."""

Collate = Callable[[Sequence[Any]], Any]


class Stage(nn.Module, ABC):
    """What is trained: a module whose call gives the scalars of a batch, "loss" among them.

    Attributes:
        name: of the stage.
        score: the measure that selects; lower is better.
        unit: of that measure.
        network: configuration of the networks, stored with the weights.
        kind: the garment, stored with the weights.
        trained: the part whose parameters change, and which the weights file holds.
    """

    name: str
    score: str
    unit: str = "mm"
    network: Any
    kind: str
    trained: nn.Module

    @abstractmethod
    def measure(self, batch: Any) -> Mapping[str, Tensor]:
        """Errors against the truth, one number per example; no gradients."""


@dataclass(frozen=True)
class TrainingOutcome:
    """How a run ended.

    Attributes:
        status: "finished" its epochs, "converged" (no improvement any more), or "interrupted".
        steps: done so far.
        best_score: the lowest score on the held-out examples.
        best_step: after how many steps that was.
        weights: file with the weights of that step; None when nothing was measured yet.
        cpu_s: CPU time of this process and of those it goes on from [s].
        unit: of the score.
    """

    status: Literal["finished", "converged", "interrupted"]
    steps: int
    best_score: float
    best_step: int
    weights: Path | None
    cpu_s: float = 0.0
    unit: str = "mm"


def train(
    stage: Stage,
    examples: Examples,
    held_out: Examples,
    config: TrainingConfig,
    folder: Path,
    *,
    collate: Collate,
    data: Mapping[str, Any] | None = None,
    processes: Processes | None = None,
    progress: Progress | None = None,
) -> TrainingOutcome:
    """Train a stage, or go on where an earlier run in this folder stopped.

    After a kill the continued run arrives at the same weights, bit by bit on a CPU with the same
    number of threads. The weights that are kept are those with the lowest score on the held-out
    examples, before the first step too: training that helps nothing changes nothing.

    Args:
        stage: on the device of its process.
        examples: to train on.
        held_out: to select by; always drawn for epoch 0.
        config: how.
        folder: gets the progress, the best weights and every scalar.
        collate: examples to a batch with a method `to(device)`.
        data: what the examples are made of; stored, and must be the same to resume.
        processes: who trains together; alone by default.
        progress: called after every step.

    Raises:
        InvalidResultError: the folder's progress is damaged or of another stage or preset, or no
            measurement was finite.
        InvalidConfigError: it is of other settings or data, another process is at work in it, or
            the loss is not finite.
        StorageError: when the disk refuses.
    """
    together = processes or Processes(device=str(next(stage.parameters()).device))
    order = BatchOrder(len(examples), config, together)
    held = _Measurement(held_out, collate, order.size, together)
    with ExitStack() as open_until_done:
        enter = open_until_done.enter_context
        if together.writes:
            enter(WorkFolder(folder, "train").alone())
        run = _Run(stage, config, folder, data or {}, together)
        run.resume()
        order.start = run.step
        log = enter(TrainingLog(folder, last_step=run.step)) if together.writes else None
        terminated = enter(_termination_noted())
        if not run.is_judged:
            run.judge(held(stage), log, epoch=0)
        batches = iter(loader(examples, order, collate, workers=config.workers))
        while run.step < order.steps and not run.converged:
            scalars = run.advance(next(batches), config.rate(run.step, order.steps_per_epoch))
            epoch = (run.step - 1) // order.steps_per_epoch
            if run.step % config.log_steps == 0 or run.step == 1:
                run.note(scalars, log, epoch)
            if run.step % (config.evaluate_epochs * order.steps_per_epoch) == 0:
                run.judge(held(stage), log, epoch=epoch)
            elif run.step % config.save_steps == 0:
                run.save()
            if progress is not None:
                place = f"{stage.name}: step {run.step}/{order.steps}"
                progress(place, run.step, order.steps)
            if together.any(terminated.is_set):
                run.save()
                return run.outcome("interrupted")
        run.save()
    if not np.isfinite(run.best_score):
        raise InvalidResultError(
            f"{folder}: no weights came of {run.step} steps, {stage.score} of the held-out "
            "examples was never finite; check what it learns from, lower high_rate "
            f"({config.high_rate}), and train in another folder"
        )
    return run.outcome("converged" if run.converged else "finished")


class _Run:
    """What changes while a stage is trained, and its way to the disk and back."""

    def __init__(
        self,
        stage: Stage,
        config: TrainingConfig,
        folder: Path,
        data: Mapping[str, Any],
        processes: Processes,
    ) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError.of(error) from error
        self.stage, self.config, self.folder, self.data = stage, config, folder, data
        self.processes = processes
        self.step, self.best_score, self.best_step, self.stale = 0, float("inf"), 0, 0
        self.is_judged = False
        self._clock = time.process_time()
        chosen = [one for one in stage.trained.parameters() if one.requires_grad]
        self.optimiser = torch.optim.Adam(chosen, lr=config.low_rate)
        alone = processes.count == 1
        self.model = stage if alone else DistributedDataParallel(stage)
        # Each process draws its own numbers from here on, and the same in every run.
        torch.manual_seed(config.seed * 1_000_003 + processes.rank)

    @property
    def cpu_s(self) -> float:
        """CPU time [s] of all runs that have brought the training here."""
        return time.process_time() - self._clock

    @property
    def converged(self) -> bool:
        """Whether patience has run out."""
        return 0 < self.config.patience <= self.stale

    def advance(self, batch: Any, rate: float) -> Mapping[str, Tensor]:
        """One step of Adam; the scalars of its batch.

        Raises:
            InvalidConfigError: when the loss is no number; no parameter has changed then.
        """
        self.stage.train()
        if self.config.freeze_statistics:
            freeze_statistics(self.stage)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        device = self.processes.device
        with torch.autocast(device.split(":")[0], torch.bfloat16, enabled=self.config.bfloat16):
            scalars = self.model(batch.to(device))
        if not np.isfinite(loss := float(scalars["loss"].detach())):
            # Seen before it gets into the weights: the last progress on disk stays sound.
            raise InvalidConfigError(
                f"the loss of {self.stage.name} is {loss} after step {self.step}; lower high_rate "
                f"({self.config.high_rate}) and start again from the last progress"
            )
        self.optimiser.zero_grad(set_to_none=True)
        scalars["loss"].backward()
        if self.config.gradient_limit:
            nn.utils.clip_grad_norm_(self.stage.trained.parameters(), self.config.gradient_limit)
        self.optimiser.step()
        self.step += 1
        return {"rate": torch.tensor(rate), **scalars}

    def note(self, scalars: Mapping[str, Tensor], log: TrainingLog | None, epoch: int) -> None:
        """Write the scalars of a step."""
        values = {name: float(value.detach()) for name, value in scalars.items()}
        if log is not None:
            log.write("train", self.step, epoch, values)

    def judge(self, measures: Mapping[str, float], log: TrainingLog | None, *, epoch: int) -> None:
        """Keep the weights if they are the best so far; save the progress in any case."""
        score = measures[self.stage.score]
        if score < self.best_score:
            self.best_score, self.best_step, self.stale = score, self.step, 0
            if self.processes.writes:
                self._share(measures)
        else:
            self.stale += 1
        if log is not None:
            log.write("held_out", self.step, epoch, measures)
        self.save()

    def _share(self, measures: Mapping[str, float]) -> None:
        provenance = {
            "stage": self.stage.name,
            "step": self.step,
            "held_out": dict(measures),
            "training": asdict(self.config),
            "data": dict(self.data),
        }
        save_weights(
            self.folder / WEIGHTS,
            self.stage.trained.state_dict(),
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
                "weights": self.stage.trained.state_dict(),
                "optimiser": self.optimiser.state_dict(),
                "generators": generators,
                "cpu_s": self.cpu_s,
            }
            save_progress(self.folder / PROGRESS, document)
        self.processes.wait()

    def resume(self) -> None:
        """Take up the progress in the folder, if there is some."""
        path = self.folder / PROGRESS
        if not path.exists():
            return
        document = load_progress(path)
        identity = self._identity()
        require_same(path, {name: document.get(name) for name in identity}, identity)
        try:
            load_tensors(self.stage.trained, document["weights"], path)
            self.optimiser.load_state_dict(document["optimiser"])
            self.step, self.stale = document["step"], document["stale"]
            self.best_score, self.best_step = document["best_score"], document["best_step"]
            generators = document["generators"]
            torch.set_rng_state(generators[self.processes.rank % len(generators)])
            self._clock -= float(document.get("cpu_s", 0.0))
        except (KeyError, ValueError, TypeError, RuntimeError, IndexError) as error:
            raise InvalidResultError(
                f"{path}: its content does not fit ({error}); remove it to train from the start"
            ) from error
        self.is_judged = True
        logger.info("%s: going on after step %d", path, self.step)

    def _identity(self) -> dict[str, Any]:
        training = {k: v for k, v in asdict(self.config).items() if k not in _MAY_CHANGE}
        return {
            "stage": self.stage.name,
            "kind": self.stage.kind,
            "network": asdict(self.stage.network),
            "training": training,
            "data": dict(self.data),
        }

    def outcome(self, status: Literal["finished", "converged", "interrupted"]) -> TrainingOutcome:
        """How it ended."""
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


class _Measurement:
    """Mean of a stage's measures over the held-out examples."""

    def __init__(
        self, examples: Examples, collate: Collate, size: int, processes: Processes
    ) -> None:
        draws: Sequence[Draw] = [(index, 0) for index in range(len(examples))]
        parts = [draws[start : start + size] for start in range(0, len(draws), size)]
        self._loader = loader(examples, processes.share(parts), collate)
        self._processes = processes

    def __call__(self, stage: Stage) -> Mapping[str, float]:
        """The means, by name."""
        stage.eval()
        found: list[dict[str, np.ndarray]] = []
        with torch.no_grad():
            for batch in self._loader:
                measures = stage.measure(batch.to(self._processes.device))
                found.append({name: value.cpu().numpy() for name, value in measures.items()})
        found = self._processes.gathered(found)
        names = found[0]
        return {name: float(np.mean(np.concatenate([f[name] for f in found]))) for name in names}


def freeze_statistics(module: nn.Module) -> None:
    """Let batch norms use, and keep, the mean and variance that they have."""
    for part in module.modules():
        if isinstance(part, nn.modules.batchnorm._BatchNorm):
            part.eval()


class _Termination:
    """Whether the system has asked us to stop."""

    is_set = False

    def note(self, number: int, frame: object) -> None:
        """Remember it; the step at hand is finished first."""
        del number, frame
        self.is_set = True


@contextmanager
def _termination_noted() -> Iterator[_Termination]:
    """SIGTERM (a scheduler's time limit, a container that stops) ends the run after its step."""
    termination = _Termination()
    try:
        before = signal.signal(signal.SIGTERM, termination.note)
    except ValueError:
        # Not the main thread: whoever started us takes care of signals.
        yield termination
        return
    try:
        yield termination
    finally:
        signal.signal(signal.SIGTERM, before)
