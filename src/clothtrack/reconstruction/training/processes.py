"""One process, or several that `torchrun` has started: sharing work, writing, synchronizing."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from torch import distributed

from clothtrack.errors import InvalidConfigError

Item = TypeVar("Item")


@dataclass(frozen=True)
class Processes:
    """The processes that train together."""

    rank: int = 0
    count: int = 1
    device: str = "cpu"

    @property
    def writes(self) -> bool:
        """Whether this process writes the files."""
        return self.rank == 0

    def share(self, items: Sequence[Item]) -> Sequence[Item]:
        """Return this process's part of the items."""
        return items[self.rank :: self.count]

    def any(self, flag: bool) -> bool:
        """Return whether the flag is set in any process; all processes must call this."""
        return flag if self.count == 1 else any(self.gathered([flag]))

    def gathered(self, items: list[Any]) -> list[Any]:
        """Return the items of all processes; all processes must call this."""
        if self.count == 1:
            return items
        parts: list[Any] = [None] * self.count
        distributed.all_gather_object(parts, items)
        return [one for part in parts for one in part]

    def wait(self) -> None:
        """Wait for the other processes."""
        if self.count > 1:
            distributed.barrier()


def require_torch_device(device: str) -> None:
    """Reject a device that PyTorch does not have."""
    number = device.removeprefix("cuda").removeprefix(":") or "0"
    if device != "cpu" and not (device.startswith("cuda") and number.isdecimal()):
        raise InvalidConfigError(f"device is {device!r}; use cpu, cuda or cuda:0")
    if device.startswith("cuda") and not torch.cuda.is_available():
        raise InvalidConfigError(
            f"device is {device}, but PyTorch {torch.__version__} sees no GPU; use --device cpu "
            "or install a build for CUDA"
        )
    if device.startswith("cuda") and int(number) >= torch.cuda.device_count():
        raise InvalidConfigError(
            f"device is {device}, but PyTorch sees {torch.cuda.device_count()} GPUs; the first "
            "is cuda:0"
        )


@contextmanager
def joined(device: str) -> Iterator[Processes]:
    """Join the processes that `torchrun` has started; without it, use this process alone."""
    require_torch_device(device)
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        yield Processes(device=device)
        return
    on_gpu = device.startswith("cuda")
    local = f"cuda:{os.environ['LOCAL_RANK']}" if on_gpu else device
    if on_gpu:
        torch.cuda.set_device(local)
    distributed.init_process_group("nccl" if on_gpu else "gloo")
    try:
        yield Processes(distributed.get_rank(), count, local)
    finally:
        distributed.destroy_process_group()
