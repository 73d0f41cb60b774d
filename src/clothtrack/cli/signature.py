"""A verb of the command line, made from the signature and the docstring of a function.

Positional arguments without a default stay positional. All others are options, and so is an output
that does not come first. Their help comes from the docstring. Arguments that a command line cannot
give (a recording in memory, an array, a function) are left out, and their types are not imported,
so that `--help` is fast. Every verb gets --verbose and --json, and --show-settings if the function
declares what its settings change (`clothtrack.api.options.configured_by`).

The help omits tyro's "(default: None)" and the type None, because the sentence about an option says
what happens without it.
"""

import dataclasses
import inspect
import re
import types
from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from tyro.conf import Positional, UseAppendAction, arg

_OF_THE_TERMINAL: Mapping[str, Any] = {
    "json": Annotated[bool, arg(name="json", help="write one JSON document to standard output")],
    "show_settings": Annotated[bool, arg(help="list what --set can change, and do nothing else")],
    "verbose": Annotated[bool, arg(name="verbose", help="log what happens, on standard error")],
}
"""Options of every verb; `show_settings` only for verbs that have settings."""

SHOW_SETTINGS = "--show-settings"

_METAVARS = {Path: "PATH", int: "INT", float: "FLOAT", str: "TEXT"}
_NOTHING = (None, "", (), False, True)
"""Defaults that the help does not show, because flags are named after what they change."""


class _Unloaded:
    """A type imported only for type checkers; a union drops it."""

    def __or__(self, other: Any) -> Any:
        return other

    __ror__ = __or__

    def __getattr__(self, name: str) -> "_Unloaded":
        return self

    def __getitem__(self, item: Any) -> "_Unloaded":
        return self


class _Names(dict[str, Any]):
    """The names of a module, including those that it imports only for type checkers."""

    def __missing__(self, name: str) -> Any:
        builtins = __builtins__ if isinstance(__builtins__, dict) else vars(__builtins__)
        return builtins[name] if name in builtins else _Unloaded()


def parameters_of(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """Return the arguments of a function that a command line can give, with their types there."""
    plain = inspect.unwrap(function)
    names = _Names(plain.__globals__)
    found = []
    for one in inspect.signature(plain).parameters.values():
        if one.kind in (one.VAR_KEYWORD, one.VAR_POSITIONAL):
            continue
        annotation = one.annotation
        if isinstance(annotation, str):
            # This evaluates our own source only, as a type checker would.
            annotation = eval(annotation, names)
        given = _given(annotation)
        if given is None:
            continue
        kind = one.KEYWORD_ONLY
        first = not any(other.kind is not other.KEYWORD_ONLY for other in found)
        if (
            one.default is one.empty
            and one.kind is not one.KEYWORD_ONLY
            and (first or one.name != "output")
        ):
            kind = one.POSITIONAL_OR_KEYWORD
        found.append(one.replace(annotation=given, kind=kind))
    return [*found, *_of_the_terminal(function)]


def _of_the_terminal(function: Callable[..., Any]) -> list[inspect.Parameter]:
    names = ["json", "verbose"]
    if configuration_of(function) is not None:
        names.insert(0, "show_settings")
    return [
        inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=_OF_THE_TERMINAL[name]
        )
        for name in names
    ]


def configuration_of(function: Callable[..., Any]) -> Callable[..., Any] | None:
    """Return the function that makes the configuration a function's settings change, if any."""
    return getattr(function, "configuration", None)


def _given(annotation: Any) -> Any:
    """Return the type that a command line can give for an annotation, or None."""
    if isinstance(annotation, _Unloaded | str | None):
        return None
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        inner = _given(arguments[0])
        return None if inner is None else Annotated[inner, *annotation.__metadata__]
    if origin in (types.UnionType, Union):
        given = _any_of([one for one in arguments if _given(one) is not None])
        return given | None if given is not None and type(None) in arguments else given
    if origin is _SEQUENCE:
        return tuple[_given(arguments[0]), ...]
    return None if origin is _CALLABLE or annotation is type(None) else annotation


def _any_of(members: Sequence[Any]) -> Any:
    """Return the union of the types that can be given; a path takes the place of text."""
    some = [_given(one) for one in members]
    wanted = [one for one in some if one is not str or Path not in some]
    return reduce(or_, wanted) if wanted else None


_CALLABLE = get_origin(Callable[[], None])
_SEQUENCE = get_origin(Sequence[int])


def command(
    function: Callable[..., Any], name: str, *, lenient: bool = False
) -> Callable[..., Callable[[], dict[str, Any]]]:
    """Return a function for tyro that takes the options of a verb and returns how to get them.

    It does not call the verb, so that tyro cannot take an error inside the verb for a wrong option.
    """
    parameters = parameters_of(function)
    if lenient:
        parameters = [_optional(one) for one in parameters]
    options = [_plain(one) for one in parameters]

    def parsed(*arguments: Any, **chosen: Any) -> Callable[[], dict[str, Any]]:
        words = [one.name for one in options if one.kind is not one.KEYWORD_ONLY]
        whole = dict(zip(words, arguments, strict=False)) | chosen
        return partial(dict, whole)

    parsed.__name__ = name
    # Join the lines about an argument; the terminal wraps them.
    parsed.__doc__ = re.sub(r"\n {8}(?=\S)", " ", inspect.getdoc(inspect.unwrap(function)) or "")
    parsed.__annotations__ = {one.name: one.annotation for one in options}
    parsed.__dict__["__signature__"] = inspect.Signature(options)
    # The type checker used in tests wraps functions, and tyro would inspect the wrapped one.
    parsed.__dict__.pop("__wrapped__", None)
    return parsed


def _optional(option: inspect.Parameter) -> inspect.Parameter:
    """Return an argument made optional."""
    if option.default is not option.empty:
        return option
    if get_origin(option.annotation) is tuple:
        return option.replace(default=())
    return option.replace(annotation=option.annotation | None, default=None)


def options_of(function: Callable[..., Any]) -> set[str]:
    """Return the options of a verb as they are written, such as "--output"."""
    written = {"--help", "-h"}
    for option in parameters_of(function):
        if option.kind is not option.KEYWORD_ONLY:
            continue
        if dataclasses.is_dataclass(option.annotation):
            for field in dataclasses.fields(option.annotation):
                written |= _written(field.name, field.type, field.default)
        else:
            written |= _written(option.name, option.annotation, option.default)
    return written


def _written(name: str, annotation: Any, default: Any) -> set[str]:
    """Return the spellings of an option."""
    configured = [one for one in get_args(annotation)[1:] if hasattr(one, "aliases")]
    aliases: set[str] = set()
    for one in configured:
        name = one.name or name
        aliases |= set(one.aliases or ())
    dashed = name.replace("_", "-")
    return {f"--no-{dashed}" if default is True else f"--{dashed}", *aliases}


def _plain(option: inspect.Parameter) -> inspect.Parameter:
    """Return an option of a verb without uninformative hints."""
    if dataclasses.is_dataclass(option.annotation):
        group = _plain_fields(option.annotation)
        fields = dataclasses.fields(option.default)
        same = {one.name: getattr(option.default, one.name) for one in fields}
        return option.replace(annotation=group, default=group(**same))
    if option.kind is not option.KEYWORD_ONLY:
        return option.replace(annotation=_word(option))
    if option.default is option.empty:
        return option
    return option.replace(annotation=_hinted(option.annotation, option.default))


def _plain_fields(group: Any) -> type:
    """Return a subclass of a group of options with plain hints."""
    fields = [
        (one.name, _hinted(one.type, one.default), dataclasses.field(default=one.default))
        for one in dataclasses.fields(group)
    ]
    made = dataclasses.make_dataclass(group.__name__, fields, bases=(group,), frozen=True)
    made.__doc__ = group.__doc__
    return made


def _word(option: inspect.Parameter) -> Any:
    """Return the named type of a positional argument; tyro assumes that a list may be empty."""
    name = option.name.upper().rstrip("_")
    if get_origin(option.annotation) is not tuple:
        return Positional[Annotated[option.annotation, arg(metavar=name)]]
    hint = arg(metavar=f"{name}...", help_behavior_hint=lambda _: "(at least one)")
    return Positional[Annotated[option.annotation, hint]]


def _hinted(annotation: Any, default: Any) -> Any:
    """Return a type with the hint that tyro shows for it."""
    if not any(default is one or (default == one == ()) for one in _NOTHING):
        return annotation
    metavar = None
    inner = get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation
    if get_origin(inner) in (types.UnionType, Union):
        some = [one for one in get_args(inner) if one is not type(None)]
        metavar = _METAVARS.get(some[0]) if len(some) == 1 else None
        if get_origin(some[0]) is Literal:
            metavar = f"{{{','.join(get_args(some[0]))}}}"
    again = "(repeatable)" if UseAppendAction in get_args(annotation) else ""
    return Annotated[annotation, arg(metavar=metavar, help_behavior_hint=lambda _: again)]
