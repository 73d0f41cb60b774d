"""Options that several verbs of the command line share."""

from itertools import groupby
from operator import attrgetter
from typing import Annotated, Any

from tyro.conf import UseAppendAction, arg

from clothtrack.cli.terminal import say

AsJson = Annotated[bool, arg(name="json", help="write one JSON document to standard output")]
Device = Annotated[str, arg(help="cpu, or cuda:0")]
Seed = Annotated[int, arg(help="seed of everything random")]
Settings = Annotated[
    tuple[str, ...],
    arg(name="set", metavar="NAME=VALUE", help="a setting, e.g. tracker.alignment.iterations=50"),
    UseAppendAction,
]
ShowSettings = Annotated[bool, arg(help="list what --set can change, and do nothing else")]


def list_settings(config: Any) -> int:
    """Write every setting of a configuration with its value and its meaning, group by group."""
    from clothtrack.files.settings import settings_of

    for group, members in groupby(settings_of(config), attrgetter("group")):
        say(f"\n[{group}]" if group else "[top]")
        for one in members:
            say(f"{one.name}={one.value}    {one.meaning}")
    return 0
