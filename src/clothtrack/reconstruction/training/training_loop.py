"""The training loop of all networks, resumable bit for bit, under torchrun or alone."""

import math
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch

from clothtrack.errors import InvalidResultError
from clothtrack.files.output_lock import locked_output
from clothtrack.files.progress import Progress
from clothtrack.reconstruction.training.batches import BatchOrder, Draw, Examples, loader
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.training.stage import Stage
from clothtrack.reconstruction.training.training_config import TrainingConfig
from clothtrack.reconstruction.training.training_log import TrainingLog
from clothtrack.reconstruction.training.training_run import TrainingOutcome, TrainingRun

Collate = Callable[[Sequence[Any]], Any]


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
    hours: float | None = None,
) -> TrainingOutcome:
    """Train a stage, or resume an earlier run in this folder.

    A run resumed after a kill ends with the same weights, bit for bit on a CPU with the same number
    of threads. The saved weights are those with the lowest score on the held-out examples. The
    start weights compete too, so a training that does not help changes nothing.

    A run with a "stable" rate may be resumed with other examples. The weights' provenance lists all
    data of the training, and the new held-out examples are measured from the start.

    Args:
        hours: wall time after which the run pauses [h]; None for no limit.
    """
    together = processes or Processes(device=str(next(stage.parameters()).device))
    order = BatchOrder(len(examples), config, together)
    held = _Measurement(held_out, collate, order.size, together)
    with ExitStack() as open_until_done:
        enter = open_until_done.enter_context
        if together.writes:
            enter(locked_output(folder))
        run = TrainingRun(stage, order, config, folder, data or {})
        run.resume()
        run.plan_fall()
        order.start = run.step
        log = enter(TrainingLog(folder, last_step=run.step)) if together.writes else None
        terminated = enter(_termination_noted())
        if not run.is_judged:
            run.judge(held(run.averaged), log)
        batches = iter(loader(examples, order, collate, workers=config.workers))
        show = progress or _show_nothing
        began_s, limit_s = time.monotonic(), 3600.0 * (math.inf if hours is None else hours)
        while run.step < order.steps and not run.converged:
            run.note(run.advance(next(batches)), log)
            if run.is_to_be_judged:
                run.judge(held(run.averaged), log)
            elif run.step % config.save_steps == 0:
                run.save()
            elapsed_s = time.monotonic() - began_s
            show(run.place, *_how_far(run, elapsed_s, limit_s))
            if together.any(terminated.is_set):
                run.save()
                return run.outcome("interrupted")
            if together.any(elapsed_s > limit_s):
                run.judge(held(run.averaged), log)
                return run.outcome("paused")
        run.save()
    if not np.isfinite(run.best_score):
        raise InvalidResultError(
            f"{folder}: no weights came of {run.step} steps, {stage.score} of the held-out "
            "examples was never finite; check what it learns from, lower high_rate "
            f"({config.high_rate}), and train in another folder"
        )
    return run.outcome("converged" if run.converged else "finished")


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
        """Return the means by name."""
        stage.eval()
        found: list[dict[str, np.ndarray]] = []
        with torch.no_grad():
            for batch in self._loader:
                measures = stage.measure(batch.to(self._processes.device))
                found.append({name: value.cpu().numpy() for name, value in measures.items()})
        found = self._processes.gathered(found)
        names = found[0]
        return {name: float(np.mean(np.concatenate([f[name] for f in found]))) for name in names}


class _Termination:
    """Flag that is set when the system asks the process to stop."""

    is_set = False

    def note(self, number: int, frame: object) -> None:
        """Set the flag; the current step is finished first."""
        del number, frame
        self.is_set = True


@contextmanager
def _termination_noted() -> Iterator[_Termination]:
    """Make SIGTERM (a scheduler's limit, a stopping container) end the run after its step."""
    termination = _Termination()
    try:
        before = signal.signal(signal.SIGTERM, termination.note)
    except ValueError:
        # Not the main thread, so the caller must handle signals.
        yield termination
        return
    try:
        yield termination
    finally:
        signal.signal(signal.SIGTERM, before)


def _show_nothing(place: str, done: int, total: int) -> None:
    """Show no progress."""


def _how_far(run: TrainingRun, elapsed_s: float, limit_s: float) -> tuple[int, int]:
    """Return done and total: of the time if there is a limit, else of the steps."""
    if math.isfinite(limit_s):
        return round(elapsed_s), math.ceil(limit_s)
    return run.step, run.order.steps if run.order.steps < sys.maxsize else 0
