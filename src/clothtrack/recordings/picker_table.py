"""The file `picker.csv`: where every picker's tip was, and when it was closed."""

import csv
import io
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from clothtrack.errors import InvalidRecordingError
from clothtrack.recordings.recording import PickerPath

COLUMNS = ("time_s", "picker", "x_m", "y_m", "z_m", "closed")
_CLOSED = {"1": True, "true": True, "0": False, "false": False}


def read_picker_paths(path: Path) -> dict[str, PickerPath]:
    """Path per picker name, samples in order of time.

    Raises:
        InvalidRecordingError: a column is missing, a field is not what it should be, or the times
            of a picker do not increase.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InvalidRecordingError(f"{path}: {error.strerror}; add the picker's path") from error
    except UnicodeDecodeError as error:
        raise InvalidRecordingError(f"{path}: not a text file; write UTF-8") from error
    rows = csv.reader(io.StringIO(text))
    head = tuple(word.strip() for word in next(rows, []))
    if head != COLUMNS:
        raise InvalidRecordingError(
            f"{path}: the first line is {','.join(head)!r}; it must be {','.join(COLUMNS)!r}"
        )
    samples: dict[str, list[tuple[float, ...]]] = {}
    for number, row in enumerate(rows, start=2):
        if row:
            name, sample = _sample(path, number, row)
            earlier = samples.setdefault(name, [])
            if earlier and sample[0] <= earlier[-1][0]:
                raise InvalidRecordingError(
                    f"{path}: line {number}: time_s of picker {name!r} is {sample[0]}, not after "
                    f"{earlier[-1][0]}; sort the rows of a picker by time and drop doubles"
                )
            earlier.append(sample)
    paths = {}
    for name, rows_of in samples.items():
        table = np.array(rows_of, dtype=np.float64)
        paths[name] = PickerPath(table[:, 0], table[:, 1:4], table[:, 4] > 0)
    return paths


def picker_text(paths: Mapping[str, PickerPath]) -> str:
    """The CSV file of the pickers' paths; every digit, so that reading gives them back."""
    lines = [",".join(COLUMNS)]
    for name, path in paths.items():
        samples = zip(path.time_s.tolist(), path.positions.tolist(), path.closed, strict=True)
        lines += [
            f"{float(time)!r},{name},{float(x)!r},{float(y)!r},{float(z)!r},{int(closed)}"
            for time, (x, y, z), closed in samples
        ]
    return "\n".join(lines) + "\n"


def _sample(path: Path, number: int, row: list[str]) -> tuple[str, tuple[float, ...]]:
    if len(row) != len(COLUMNS):
        raise InvalidRecordingError(
            f"{path}: line {number} has {len(row)} fields; it must have {len(COLUMNS)}: "
            f"{','.join(COLUMNS)}"
        )
    fields = {column: word.strip() for column, word in zip(COLUMNS, row, strict=True)}
    numbers = []
    for column in ("time_s", "x_m", "y_m", "z_m"):
        try:
            value = float(fields[column])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InvalidRecordingError(
                f"{path}: line {number}: {column} is {fields[column]!r}; write a number"
            )
        numbers.append(value)
    closed = _CLOSED.get(fields["closed"].lower())
    if closed is None:
        raise InvalidRecordingError(
            f"{path}: line {number}: closed is {fields['closed']!r}; write 1 or 0"
        )
    if not fields["picker"]:
        raise InvalidRecordingError(f"{path}: line {number}: picker is empty; name the picker")
    return fields["picker"], (*numbers, float(closed))
