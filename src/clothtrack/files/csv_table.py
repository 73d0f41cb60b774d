"""CSV files with declared columns; a wrong field is refused with its line, value and remedy."""

import csv
import io
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clothtrack.errors import InvalidRecordingError, why_unreadable


@dataclass(frozen=True)
class Column:
    """The type of a column.

    Attributes:
        read: converts a field, stripped of blanks, to a value; raises ValueError if it is wrong.
    """

    read: Callable[[str], Any]
    remedy: str


def finite(word: str) -> float:
    """Return a finite number; raise ValueError otherwise."""
    value = float(word)
    if not math.isfinite(value):
        raise ValueError(word)
    return value


def filled(word: str) -> str:
    """Return a text that is not empty; raise ValueError otherwise."""
    if not word:
        raise ValueError(word)
    return word


NUMBER = Column(finite, "write a number")


def read_csv(path: Path, columns: Mapping[str, Column]) -> Iterator[tuple[str, list[Any]]]:
    """Yield the place ("FILE: line 7") and values of every nonempty row below the header."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InvalidRecordingError(f"{path}: {why_unreadable(error, 'add the file')}") from error
    except UnicodeDecodeError as error:
        raise InvalidRecordingError(f"{path}: not a text file; write UTF-8") from error
    names = ",".join(columns)
    rows = csv.reader(io.StringIO(text))
    try:
        head = ",".join(word.strip() for word in next(rows, []))
        if head != names:
            raise InvalidRecordingError(f"{path}: the first line is {head!r}; it must be {names!r}")
        for row in filter(None, rows):
            place = f"{path}: line {rows.line_num}"
            if len(row) != len(columns):
                raise InvalidRecordingError(
                    f"{place} has {len(row)} fields; it must have {len(columns)}: {names}"
                )
            yield place, [_value(place, *pair) for pair in zip(columns.items(), row, strict=True)]
    except csv.Error as error:
        raise InvalidRecordingError(f"{path}: not a CSV file ({error}); write one") from error


def _value(place: str, named: tuple[str, Column], word: str) -> Any:
    name, column = named
    try:
        return column.read(word.strip())
    except ValueError as error:
        raise InvalidRecordingError(
            f"{place}: {name} is {word.strip()!r}; {column.remedy}"
        ) from error
