"""The order of training examples: split by group, order by seed and epoch, batches by step.

Everything is a function of seed, epoch and index, so that a resumed run sees the same examples as
an uninterrupted run, for any number of processes that make them.
"""

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Int
from torch import Generator
from torch.utils.data import DataLoader

from clothtrack.errors import InvalidConfigError
from clothtrack.files.worker_pool import start_worker
from clothtrack.reconstruction.training.processes import Processes
from clothtrack.reconstruction.training.training_config import TrainingConfig

Draw = tuple[int, int]
"""Index of an example, and the epoch that its random numbers are drawn for."""


@runtime_checkable
class Examples(Protocol):
    """A set of examples, each a function of its index and the epoch."""

    def __len__(self) -> int:
        """Return the number of examples."""
        ...

    def __getitem__(self, draw: Draw) -> Any:
        """Return the example, augmented for this epoch."""
        ...


def split_by_group(
    groups: Sequence[Any], held_out_share: float, seed: int
) -> tuple[Int[np.ndarray, " training"], Int[np.ndarray, " held_out"]]:
    """Return indices to train on and to hold out; examples of one group stay together."""
    names = list(dict.fromkeys(groups))
    if len(names) < 2:
        raise InvalidConfigError(
            f"{len(groups)} examples of {len(names)} trajectory or episode; training needs two or "
            "more, one of them to select by: add data"
        )
    held = max(1, min(len(names) - 1, round(held_out_share * len(names))))
    order = np.random.default_rng([seed, len(names)]).permutation(len(names))
    chosen = {names[index] for index in order[:held]}
    is_held = np.array([group in chosen for group in groups])
    return np.flatnonzero(~is_held), np.flatnonzero(is_held)


class Subset:
    """A subset of examples."""

    def __init__(self, examples: Examples, indices: Int[np.ndarray, " chosen"]) -> None:
        self.examples = examples
        self.indices = indices

    def __len__(self) -> int:
        """Return the number of examples."""
        return len(self.indices)

    def __getitem__(self, draw: Draw) -> Any:
        """Return the example, augmented for this epoch."""
        index, epoch = draw
        return self.examples[int(self.indices[index]), epoch]


class BatchOrder:
    """This process's part of the batches of a run, from a step on.

    Attributes:
        steps: total steps of the run; unlimited for a "stable" rate.
        from_step: step at which the examples were last changed.
        first_epoch: number of the epoch that begins there, so that no epoch is drawn twice.
    """

    def __init__(self, count: int, config: TrainingConfig, processes: Processes) -> None:
        self.count = count
        self.from_step, self.first_epoch = 0, 0
        self.size = min(config.batch_size, count)
        if self.size % processes.count:
            raise InvalidConfigError(
                f"batch_size is {self.size} for {processes.count} processes; it must be a multiple"
            )
        # Examples left over after whole batches are skipped in this epoch.
        self.steps_per_epoch = count // self.size
        endless = config.decay == "stable"
        self.steps = sys.maxsize if endless else config.epochs * self.steps_per_epoch
        self.start = 0
        self._seed = config.seed
        self.processes = processes

    def __len__(self) -> int:
        """Return the number of remaining steps."""
        return self.steps - self.start

    def epoch(self, step: int) -> int:
        """Return the number of the epoch that a step is in."""
        return self.first_epoch + (step - self.from_step) // self.steps_per_epoch

    def __iter__(self) -> Iterator[Sequence[Draw]]:
        """Iterate over the examples of each step."""
        order = np.zeros(0, np.int64)
        for step in range(self.start, self.steps):
            epoch, position = self.epoch(step), (step - self.from_step) % self.steps_per_epoch
            if position == 0 or step == self.start:
                order = np.random.default_rng([self._seed, epoch]).permutation(self.count)
            chosen = order[position * self.size : (position + 1) * self.size]
            yield self.processes.share([(int(index), epoch) for index in chosen])


def loader(
    examples: Examples,
    order: Sequence[Sequence[Draw]] | BatchOrder,
    collate: Callable[[Sequence[Any]], Any],
    *,
    workers: int = 0,
) -> DataLoader:
    """Make batches, in this process or in worker processes."""
    workers = min(workers, _cores())
    return DataLoader(
        examples,
        batch_sampler=order,
        collate_fn=collate,
        num_workers=workers,
        # Forks of a multithreaded process can hang.
        multiprocessing_context="spawn" if workers else None,
        # Use a separate generator, because the global one is for the network and saved with it.
        generator=Generator(),
        worker_init_fn=_start,
    )


def _cores() -> int:
    """Return the number of cores that this process may use; PyTorch warns of more workers."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _start(number: int) -> None:
    """Initialize the worker like the package's other workers."""
    del number
    start_worker()
