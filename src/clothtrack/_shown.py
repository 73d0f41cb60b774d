"""Short texts and small tables of public objects, for a terminal and a notebook."""

from collections.abc import Mapping, Sized
from dataclasses import fields
from html import escape
from typing import Any

_LONGEST, _MOST = 60, 4
"""Characters and entries up to which a value is written out."""


def short_repr(self: Any) -> str:
    """Return a dataclass as one line: of an array only type and shape, of a long value its size."""
    shown = (f"{each.name}={_word(getattr(self, each.name))}" for each in fields(self) if each.repr)
    return f"{type(self).__name__}({', '.join(shown)})"


def html_table(title: str, rows: Mapping[str, object]) -> str:
    """Return a small table of names and values for a notebook; all text is escaped."""
    lines = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(str(value))}</td></tr>'
        for name, value in rows.items()
    )
    return f"<table><caption>{escape(title)}</caption>{lines}</table>"


def _word(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if hasattr(value, "dtype"):
        return str(value.tolist()) if value.size <= _MOST else f"{value.dtype}{[*value.shape]}"
    count = len(value) if isinstance(value, Sized) else 0
    if isinstance(value, str) or count <= _MOST:
        text = repr(value)
        if len(text) <= _LONGEST and "\n" not in text:
            return text
        if isinstance(value, str):
            return f"{text[:_LONGEST]}...{text[-1]}"
    return f"<{count} entries>" if count else f"{type(value).__name__}(...)"
