"""The settings that a folder was begun with, so that only the same work is resumed in it."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.files.atomic_write import storage, write_file

_LONGEST = 40
"""Longest value that a message shows [characters]."""


def as_plain(asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings as they come back from JSON."""
    return json.loads(json.dumps(asked, default=str))


def begin_run(path: Path, asked: Mapping[str, Any]) -> None:
    """Record the settings of a folder in a file, or refuse a folder begun with others."""
    if not path.exists():
        write_file(path, json.dumps(as_plain(asked), indent=1).encode())
        return
    try:
        with storage(path):
            stored = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InvalidResultError(
            f"{path}: not what the folder was begun with ({error}); remove the folder and begin "
            "again"
        ) from error
    require_same(path, stored, asked)


def require_same(path: Path, stored: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    """Refuse to continue work that was begun with other settings."""
    for name, was, now in _differing(stored, as_plain(asked)):
        raise InvalidConfigError(
            f"{path}: begun with another {name} ({was}, now {now}); choose another folder, or "
            "remove this one"
        )


def _differing(stored: Any, asked: Any, name: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield the name of each value that differs, with both values shortened."""
    if isinstance(stored, Mapping) and isinstance(asked, Mapping):
        for key in sorted(set(stored) | set(asked)):
            inner = f"{name}.{key}" if name else key
            yield from _differing(stored.get(key), asked.get(key), inner)
    elif stored != asked:
        yield name, _in_short(stored), _in_short(asked)


def _in_short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
