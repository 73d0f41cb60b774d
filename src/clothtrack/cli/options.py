"""Options that several verbs of the command line share."""

import re
import shlex
from collections.abc import Sequence
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import UseAppendAction, arg

from clothtrack.cli.terminal import say
from clothtrack.errors import InvalidConfigError

if TYPE_CHECKING:
    from clothtrack.files.shared_work import Executor, Share

AsJson = Annotated[bool, arg(name="json", help="write one JSON document to standard output")]
Device = Annotated[str, arg(help="cpu, or cuda:0")]
Ray = Annotated[
    str,
    arg(
        metavar="ADDRESS",
        help="let Ray do it: 'local' with WORKERS processes here, or the address of a cluster, "
        "such as auto or ray://HOST:10001; docs/many_machines.md",
    ),
]
RayMemory = Annotated[
    float, arg(metavar="GB", help="memory that Ray keeps free for each item; 0: it does not ask")
]
Seed = Annotated[int, arg(help="seed of everything random")]
Settings = Annotated[
    tuple[str, ...],
    arg(name="set", metavar="NAME=VALUE"),
    UseAppendAction,
]
Shard = Annotated[
    str,
    arg(
        metavar="I/N",
        help="do only the I-th of N parts, I from 1; for a Slurm array, docs/many_machines.md",
    ),
]
ShowSettings = Annotated[bool, arg(help="list what --set can change, and do nothing else")]


def list_settings(config: Any) -> int:
    """Write every setting of a configuration with its value and its meaning, group by group."""
    from clothtrack.files.settings import settings_of

    for group, members in groupby(settings_of(config), attrgetter("group")):
        say(f"\n[{group}]" if group else "[top]")
        for setting in members:
            say(f"{setting.name}={setting.value}    {setting.meaning}")
    return 0


def require_weights(path: Path) -> None:
    """Refuse weights that are not there.

    Raises:
        InvalidConfigError: naming the file.
    """
    if not path.is_file():
        raise InvalidConfigError(f"{path}: there is no such weights file; check the name")


_written: list[str] = []


def remember(words: Sequence[str]) -> None:
    """Keep the words after `clothtrack`, for whoever wants to tell the command again."""
    _written[:] = words


def share_of(shard: str) -> "Share":
    """The share of the work that --shard asks for, and the command that asks for all of it.

    Raises:
        InvalidConfigError: it is no share.
    """
    from clothtrack.files.shared_work import Share

    command = shlex.join(["clothtrack", *_written])
    return Share.parse(shard, re.sub(r" --shard[= ]\S+", "", command))


def executor_of(ray: str, ray_memory: float, device: str = "cpu") -> "Executor":
    """Who runs the work: worker processes, or Ray where --ray says so.

    Args:
        ray: address of Ray, or nothing.
        ray_memory: of an item [10^9 bytes].
        device: where to compute; on a graphics card an item has one of its own.

    Raises:
        InvalidConfigError: --ray-memory without --ray, or it is negative.
    """
    if ray:
        from clothtrack.files.ray_executor import RayExecutor

        return RayExecutor(ray, ray_memory, 0.0 if device == "cpu" else 1.0)
    if ray_memory:
        raise InvalidConfigError(f"--ray-memory is {ray_memory:g}, without --ray; leave it out")
    from clothtrack.files.worker_pool import finished_in_workers

    return finished_in_workers
