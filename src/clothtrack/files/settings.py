"""List and change single settings of a nested configuration by their dotted names."""

import inspect
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from difflib import get_close_matches
from textwrap import shorten
from typing import Any, NamedTuple, TypeVar

from clothtrack.errors import InvalidConfigError

Config = TypeVar("Config")

_LINE = 120
"""Longest description of a setting [characters]."""


class Setting(NamedTuple):
    """One value that can be changed by its name.

    Attributes:
        group: dotted name of its group; empty at the top.
        meaning: first sentence of its description in the docstring of its class, shortened.
    """

    group: str
    name: str
    value: str
    meaning: str


def settings_of(config: Any, group: str = "", meaning: str = "") -> Iterator[Setting]:
    """Yield all settings that `with_settings` can change, a group before those below it."""
    if isinstance(config, Mapping):
        values, meanings = dict(config), dict.fromkeys(config, meaning)
    else:
        values = {field.name: getattr(config, field.name) for field in fields(config)}
        meanings = _meanings(type(config))
    below = []
    for key, value in values.items():
        name = f"{group}.{key}" if group else str(key)
        if is_dataclass(value) or isinstance(value, Mapping):
            below.append((value, name, meanings.get(key, "")))
        elif value is not None and not _is_group(value):  # tables and sensors have no text form
            text = value if isinstance(value, str) else json.dumps(value)
            yield Setting(group, name, text, meanings.get(key, ""))
    for one in below:
        yield from settings_of(*one)


def _meanings(owner: type) -> dict[str, str]:
    """Return the first sentence about each attribute in the docstring of a class."""
    _, _, attributes = inspect.cleandoc(owner.__doc__ or "").partition("Attributes:\n")
    entry = re.compile(r"^    (\w[\w, ]*): (.*(?:\n     +.*)*)", re.MULTILINE)
    found = {}
    for names, text in entry.findall(attributes):
        sentence = re.split(r"\.(?: (?=[A-Z])|$)", " ".join(text.split()))[0]
        found.update(dict.fromkeys(names.split(", "), shorten(sentence, _LINE, placeholder=" ...")))
    return found


def with_settings(config: Config, settings: Sequence[str]) -> Config:
    """Return a configuration with some values replaced, such as `objective.iterations=50`.

    Args:
        config: a frozen dataclass, nested at will; mappings may be entered by their keys.
        settings: `dotted.name=value`; values are written as in JSON; True, False and None of Python
            are accepted, too, and bare words are strings.

    Raises:
        InvalidConfigError: naming the setting, what is wrong with it and what is allowed.
    """
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise InvalidConfigError(f"setting {setting!r} has no value; write {setting}=VALUE")
        try:
            config = _replaced(config, name.strip().split("."), _parsed(text.strip()), name)
        except _UnknownError as unknown:
            if close := _like(name.strip(), config):
                raise InvalidConfigError(
                    f"{name}: there is no such setting; did you mean {' or '.join(close)}?"
                ) from None
            raise InvalidConfigError(str(unknown)) from None
        except InvalidConfigError as error:
            # A group knows its class and the field, but not where it is among the settings.
            said, _, rest = str(error).partition(" is ")
            group, _, field = name.strip().rpartition(".")
            if not group or said.rpartition(".")[2] != field:
                raise
            raise InvalidConfigError(f"{name.strip()} is {rest}") from None
    return config


class _UnknownError(InvalidConfigError):
    """There is no setting of this name."""


def _like(name: str, config: Any) -> list[str]:
    """Return the settings that a wrong name may mean, by the similarity of the last part."""
    last: dict[str, list[str]] = {}
    for setting in settings_of(config):
        last.setdefault(setting.name.rpartition(".")[2], []).append(setting.name)
    groups, _, wanted = name.rpartition(".")
    close = [last[one] for one in get_close_matches(wanted, last, 1)]
    found = [one for names in close for one in names]
    return get_close_matches(name, found, 1) if groups else found[:3]


_PYTHON_WORDS = {"True": True, "False": False, "None": None}


def _parsed(text: str) -> Any:
    if text in _PYTHON_WORDS:
        return _PYTHON_WORDS[text]
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        # This includes numbers with more digits than Python reads.
        return text


def _replaced(owner: Any, path: list[str], value: Any, name: str) -> Any:
    if isinstance(owner, Mapping):
        known = [str(key) for key in owner]
    elif is_dataclass(owner):
        known = [field.name for field in fields(owner)]
    elif owner is None:
        raise InvalidConfigError(f"{name} cannot be set here; leave it out")
    else:
        raise InvalidConfigError(f"{name}: there is nothing below {type(owner).__name__}")
    head, *rest = path
    if head not in known:
        raise _UnknownError(f"{name}: there is no {head!r}; known are {', '.join(known)}")
    is_mapping = isinstance(owner, Mapping)
    old = owner[head] if is_mapping else getattr(owner, head)
    new = _replaced(old, rest, value, name) if rest else _of_same_type(old, value, name)
    return {**owner, head: new} if is_mapping else replace(owner, **{head: new})


def _of_same_type(old: Any, new: Any, name: str) -> Any:
    """Return the new value if it has the type of the old one; lists become tuples."""
    new = tuple(new) if isinstance(new, list) else new
    if isinstance(old, bool) or isinstance(new, bool):
        fits = isinstance(old, bool) and isinstance(new, bool)
    elif isinstance(old, float):
        fits = isinstance(new, int | float)
        new = float(new) if fits else new
    elif isinstance(old, list | tuple):
        fits = isinstance(new, tuple)
    else:
        fits = old is None or isinstance(new, type(old))
    if not fits or _is_group(old):
        raise InvalidConfigError(
            f"{name}: {json.dumps(new):.120} cannot replace {_shown(old)}, which is {_kind(old)}"
        )
    return new


def _is_group(value: Any) -> bool:
    """Return whether a value is a group of settings instead of a setting."""
    held = value if isinstance(value, tuple) else (value,)
    return any(is_dataclass(one) or isinstance(one, Mapping) for one in held)


def _shown(value: Any) -> str:
    """Return a value as a message shows it; for a group, the name of its type."""
    return type(value).__name__ if _is_group(value) else f"{value!r:.120}"


_KINDS = {
    bool: "true or false", int: "a whole number", float: "a number", str: "a text",
    tuple: "a list", list: "a list",
}  # fmt: skip


def _kind(value: Any) -> str:
    """Return the type of a value in words."""
    if _is_group(value):
        return "a group of settings"
    return _KINDS.get(type(value), "a group of settings")


def from_plain(config: Config, values: Mapping[str, Any]) -> Config:
    """Return a configuration with stored values (`dataclasses.asdict`, through JSON)."""
    known = {field.name for field in fields(config)}
    if differing := sorted(known ^ set(values)):
        raise InvalidConfigError(
            f"{type(config).__name__}: {differing[0]!r:.80} is known to one only"
        )
    changes = {}
    for name in known:
        old, new = getattr(config, name), values[name]
        if is_dataclass(old) and isinstance(new, Mapping):
            changes[name] = from_plain(old, new)
        else:
            changes[name] = _without_lists(new)
    try:
        return replace(config, **changes)
    except (TypeError, ValueError, AttributeError) as error:
        raise InvalidConfigError(f"{type(config).__name__}: {error}") from error


def _without_lists(value: Any) -> Any:
    """Return a value with its lists turned back into the tuples that they were before JSON."""
    if isinstance(value, Mapping):
        return {key: _without_lists(one) for key, one in value.items()}
    return tuple(map(_without_lists, value)) if isinstance(value, list | tuple) else value
