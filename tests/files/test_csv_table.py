"""CSV files are read as declared, or refused with line, value and remedy."""

import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack.files.csv_table import NUMBER, Column, filled, read_csv

COLUMNS = {"time_s": NUMBER, "name": Column(filled, "name it")}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "the first line is ''; it must be 'time_s,name'"),
        (b"time,name\n", "the first line is 'time,name'"),
        (b"time_s,name\n1\n", r"line 2 has 1 fields; it must have 2: time_s,name"),
        (b"time_s,name\nx,a\n", "line 2: time_s is 'x'; write a number"),
        (b"time_s,name\nnan,a\n", "line 2: time_s is 'nan'; write a number"),
        (b"time_s,name\n1,a\n2, \n", "line 3: name is ''; name it"),
        (b"time_s,name\n1,\xff\n", "not a text file; write UTF-8"),
        (b"time_s,name\n1," + b"a" * 200_000, "not a CSV file"),
    ],
)
def test_what_is_not_as_declared_is_refused(tmp_path, content, words):
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(InvalidRecordingError, match=words):
        list(read_csv(tmp_path / "a.csv", COLUMNS))
    with pytest.raises(InvalidRecordingError, match="add the file"):
        list(read_csv(tmp_path / "missing.csv", COLUMNS))
