"""A verb as the command line sees it: parsed first, run later, with help that says no empty things.

Every verb gets --verbose. What tyro would write of a default that is none ("(default: None)") is
left out, and so is the type None: the sentence about an option says what happens without it.
"""

import dataclasses
import inspect
import types
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from tyro.conf import UseAppendAction, arg

Verbose = Annotated[bool, arg(name="verbose", help="log what happens, on standard error")]

_METAVARS = {Path: "PATH", int: "INT", float: "FLOAT", str: "TEXT"}
_NOTHING = (None, "", (), False, True)
"""Defaults that need no word: flags are named after what they change."""


def name_of(verb: Callable[..., int]) -> str:
    """The verb as it is written."""
    return verb.__name__.replace("_", "-")


def command(verb: Callable[..., int]) -> Callable[..., Callable[[], int]]:
    """The verb for tyro: called with its options, it gives what runs it.

    Options are refused by tyro alone, so that an error inside a verb is never taken for one.
    """
    signature = inspect.signature(verb)
    options = [_plain(one) for one in signature.parameters.values()]
    verbose = inspect.Parameter(
        "verbose", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=_hinted(Verbose, False)
    )

    def parsed(*arguments: Any, verbose: bool, **chosen: Any) -> Callable[[], int]:
        del verbose  # heard before anything is parsed
        return partial(verb, *arguments, **chosen)

    parsed.__name__, parsed.__doc__ = verb.__name__, verb.__doc__
    every = [*options, verbose]
    parsed.__annotations__ = {one.name: one.annotation for one in every}
    parsed.__dict__["__signature__"] = signature.replace(parameters=every)
    # What checks types in tests wraps a function, and tyro would look at the one inside.
    parsed.__dict__.pop("__wrapped__", None)
    return parsed


def options_of(verb: Callable[..., int]) -> set[str]:
    """The options of a verb as they are written, such as "--output"."""
    written = {"--help", "-h", "--verbose"}
    for option in inspect.signature(verb).parameters.values():
        if option.kind is not option.KEYWORD_ONLY:
            continue
        if dataclasses.is_dataclass(option.annotation):
            for field in dataclasses.fields(option.annotation):
                written |= _written(field.name, field.type, field.default)
        else:
            written |= _written(option.name, option.annotation, option.default)
    return written


def _written(name: str, annotation: Any, default: Any) -> set[str]:
    """How an option can be written."""
    configured = [one for one in get_args(annotation)[1:] if hasattr(one, "aliases")]
    aliases: set[str] = set()
    for one in configured:
        name = one.name or name
        aliases |= set(one.aliases or ())
    dashed = name.replace("_", "-")
    return {f"--no-{dashed}" if default is True else f"--{dashed}", *aliases}


def _plain(option: inspect.Parameter) -> inspect.Parameter:
    """An option of a verb, without hints that say nothing."""
    if dataclasses.is_dataclass(option.annotation):
        group = _plain_fields(option.annotation)
        fields = dataclasses.fields(option.default)
        same = {one.name: getattr(option.default, one.name) for one in fields}
        return option.replace(annotation=group, default=group(**same))
    if option.default is option.empty:
        return option.replace(annotation=_listed(option.annotation))
    return option.replace(annotation=_hinted(option.annotation, option.default))


def _plain_fields(group: Any) -> type:
    """The same group of options with plain hints; what is made of it is one of the group."""
    fields = [
        (one.name, _hinted(one.type, one.default), dataclasses.field(default=one.default))
        for one in dataclasses.fields(group)
    ]
    made = dataclasses.make_dataclass(group.__name__, fields, bases=(group,), frozen=True)
    made.__doc__ = group.__doc__
    return made


def _listed(annotation: Any) -> Any:
    """A list of files, of which tyro thinks that it may be empty; other types stay as they are."""
    if get_origin(next(iter(get_args(annotation)), None)) is not tuple:
        return annotation
    return Annotated[
        annotation, arg(metavar="PATH...", help_behavior_hint=lambda _: "(at least one)")
    ]


def _hinted(annotation: Any, default: Any) -> Any:
    """A type with what tyro is to say of it."""
    if not any(default is one or (default == one == ()) for one in _NOTHING):
        return annotation
    metavar = None
    if get_origin(annotation) in (types.UnionType, Union):
        some = [one for one in get_args(annotation) if one is not type(None)]
        metavar = _METAVARS.get(some[0]) if len(some) == 1 else None
        if get_origin(some[0]) is Literal:
            metavar = f"{{{','.join(get_args(some[0]))}}}"
    again = "(repeatable)" if UseAppendAction in get_args(annotation) else ""
    return Annotated[annotation, arg(metavar=metavar, help_behavior_hint=lambda _: again)]
