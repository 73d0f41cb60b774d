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
    from clothtrack.files.shared_work import Share

AsJson = Annotated[bool, arg(name="json", help="write one JSON document to standard output")]
Device = Annotated[str, arg(help="cpu, or cuda:0")]
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
