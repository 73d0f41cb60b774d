"""Options that several verbs of the command line share."""

from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import UseAppendAction, arg

from clothtrack.cli.terminal import say
from clothtrack.errors import InvalidConfigError

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
Seed = Annotated[int, arg(help="seed of everything random")]
Settings = Annotated[
    tuple[str, ...],
    arg(name="set", metavar="NAME=VALUE"),
    UseAppendAction,
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
