"""Which example comes when: split by group, order by seed and epoch, batches by step.

Everything is a function of seed, epoch and index, so that a resumed run sees what the run that was
killed would have seen, however many processes make the examples.
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
        """How many there are."""
        ...

    def __getitem__(self, draw: Draw) -> Any:
        """The example, augmented for this epoch."""
        ...


def split_by_group(
    groups: Sequence[Any], held_out_share: float, seed: int
) -> tuple[Int[np.ndarray, " training"], Int[np.ndarray, " held_out"]]:
    """Indices to train on and to hold out; what belongs together stays together.

    Args:
        groups: of each example: its trajectory or episode.
        held_out_share: share of the groups to hold out; at least one is.
        seed: of the choice.

    Raises:
        InvalidConfigError: there are fewer than two groups.
    """
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
    """Some examples of a set."""

    def __init__(self, examples: Examples, indices: Int[np.ndarray, " chosen"]) -> None:
        self.examples = examples
        self.indices = indices

    def __len__(self) -> int:
        """How many there are."""
        return len(self.indices)

    def __getitem__(self, draw: Draw) -> Any:
        """The example, augmented for this epoch."""
        index, epoch = draw
        return self.examples[int(self.indices[index]), epoch]


class BatchOrder:
    """The batches of a run from a step on, this process's part of each.

    Attributes:
        steps: that the run has in all; without end for a rate that stays.
        start: the first step that is asked for.
        from_step: step at which the examples were last changed.
        first_epoch: number of the epoch that begins there, so that no epoch is drawn twice.
        processes: who takes part.

    Args:
        count: examples.
        config: batch size, epochs and seed.
        processes: who takes part.

    Raises:
        InvalidConfigError: the batch cannot be shared out evenly.
    """

    def __init__(self, count: int, config: TrainingConfig, processes: Processes) -> None:
        self.count = count
        self.from_step, self.first_epoch = 0, 0
        self.size = min(config.batch_size, count)
        if self.size % processes.count:
            raise InvalidConfigError(
                f"batch_size is {self.size} for {processes.count} processes; it must be a multiple"
            )
        # What is left over after whole batches waits for another epoch's order.
        self.steps_per_epoch = count // self.size
        endless = config.decay == "stable"
        self.steps = sys.maxsize if endless else config.epochs * self.steps_per_epoch
        self.start = 0
        self._seed = config.seed
        self.processes = processes

    def __len__(self) -> int:
        """Steps that are left."""
        return self.steps - self.start

    def epoch(self, step: int) -> int:
        """Return the number of the epoch that a step is in."""
        return self.first_epoch + (step - self.from_step) // self.steps_per_epoch

    def __iter__(self) -> Iterator[Sequence[Draw]]:
        """Each step's examples."""
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
    """Make batches, in this process or in others beside it.

    Args:
        examples: the set.
        order: what each batch consists of.
        collate: examples to a batch.
        workers: processes, as many as there are cores at most; none: in this one.
    """
    workers = min(workers, _cores())
    return DataLoader(
        examples,
        batch_sampler=order,
        collate_fn=collate,
        num_workers=workers,
        # Forks of a process that computes with threads can hang.
        multiprocessing_context="spawn" if workers else None,
        # Its own generator: the global one belongs to the network, and is saved with it.
        generator=Generator(),
        worker_init_fn=_start,
    )


def _cores() -> int:
    """Processor cores that this process may use; PyTorch warns of more workers."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _start(number: int) -> None:
    """Begin as the package's other workers do."""
    del number
    start_worker()
