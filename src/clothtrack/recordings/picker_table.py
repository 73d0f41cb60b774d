"""The file `picker.csv`: the path of every picker's tip, and when the picker was closed."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from clothtrack.errors import InvalidRecordingError
from clothtrack.files.csv_table import NUMBER, Column, filled, read_csv
from clothtrack.recordings.recording import PickerPath

PICKER_FILE = "picker.csv"


def _closed(word: str) -> bool:
    return ("0", "false", "1", "true").index(word.lower()) > 1


COLUMNS = {
    "time_s": NUMBER,
    "picker": Column(filled, "name the picker"),
    "x_m": NUMBER,
    "y_m": NUMBER,
    "z_m": NUMBER,
    "closed": Column(_closed, "write 1 or 0"),
}


def read_picker_paths(path: Path) -> dict[str, PickerPath]:
    """Return the path per picker name, samples in order of time."""
    samples: dict[str, list[tuple[float, ...]]] = {}
    for place, (time, name, *sample) in read_csv(path, COLUMNS):
        earlier = samples.setdefault(name, [])
        if earlier and time <= earlier[-1][0]:
            raise InvalidRecordingError(
                f"{place}: time_s of picker {name!r} is {time}, not after {earlier[-1][0]}; sort "
                "the rows of a picker by time and drop doubles"
            )
        earlier.append((time, *sample))
    tables = {name: np.array(rows, dtype=np.float64) for name, rows in samples.items()}
    return {
        name: PickerPath(table[:, 0], table[:, 1:4], table[:, 4] > 0)
        for name, table in tables.items()
    }


def picker_text(paths: Mapping[str, PickerPath]) -> str:
    """Return the CSV file of the pickers' paths, with all digits so that reading is exact."""
    lines = [",".join(COLUMNS)]
    for name, path in paths.items():
        samples = zip(path.time_s.tolist(), path.positions.tolist(), path.closed, strict=True)
        lines += [
            f"{float(time)!r},{name},{float(x)!r},{float(y)!r},{float(z)!r},{int(closed)}"
            for time, (x, y, z), closed in samples
        ]
    return "\n".join(lines) + "\n"
