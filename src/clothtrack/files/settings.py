"""Change single settings of a nested configuration by their dotted names."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

from clothtrack.errors import InvalidConfigError

Config = TypeVar("Config")


def with_settings(config: Config, settings: Sequence[str]) -> Config:
    """A configuration with some values replaced, such as `tracker.alignment.iterations=50`.

    Args:
        config: a frozen dataclass, nested at will; mappings may be entered by their keys.
        settings: `dotted.name=value`; values are written as in JSON, True, False and None as in
            Python too, and bare words are texts.

    Raises:
        InvalidConfigError: naming the setting, what is wrong with it and what is allowed.
    """
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise InvalidConfigError(f"setting {setting!r} has no value; write {setting}=VALUE")
        config = _replaced(config, name.strip().split("."), _parsed(text.strip()), name)
    return config


_PYTHON_WORDS = {"True": True, "False": False, "None": None}


def _parsed(text: str) -> Any:
    if text in _PYTHON_WORDS:
        return _PYTHON_WORDS[text]
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def _replaced(owner: Any, path: list[str], value: Any, name: str) -> Any:
    if isinstance(owner, Mapping):
        known = [str(key) for key in owner]
    elif is_dataclass(owner):
        known = [field.name for field in fields(owner)]
    else:
        raise InvalidConfigError(f"{name}: there is nothing below {type(owner).__name__}")
    head, *rest = path
    if head not in known:
        raise InvalidConfigError(f"{name}: there is no {head!r}; known are {', '.join(known)}")
    is_mapping = isinstance(owner, Mapping)
    old = owner[head] if is_mapping else getattr(owner, head)
    new = _replaced(old, rest, value, name) if rest else _of_same_type(old, value, name)
    return {**owner, head: new} if is_mapping else replace(owner, **{head: new})


def _of_same_type(old: Any, new: Any, name: str) -> Any:
    """Take the new value when it is of the kind that the old one was; lists become tuples."""
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
    if not fits or is_dataclass(old) or isinstance(old, Mapping):
        raise InvalidConfigError(
            f"{name}: {json.dumps(new)} cannot replace {old!r}, which is a {type(old).__name__}"
        )
    return new
