"""Options that several verbs of the command line share."""

from typing import Annotated

from tyro.conf import UseAppendAction, arg

AsJson = Annotated[bool, arg(name="json", help="write one JSON document to standard output")]
Device = Annotated[str, arg(help="cpu, or cuda:0")]
Seed = Annotated[int, arg(help="seed of everything random")]
Settings = Annotated[
    tuple[str, ...],
    arg(name="set", metavar="NAME=VALUE", help="a setting, e.g. tracker.alignment.iterations=50"),
    UseAppendAction,
]
