"""One thing that is wrong with a recording: where, what, and what to do about it."""

import json
from dataclasses import dataclass
from pathlib import Path

from clothtrack.errors import ClothTrackError


@dataclass(frozen=True)
class Violation:
    """One thing that is wrong with a recording.

    Attributes:
        file: path inside the recording.
        field: where in the file ("cameras[0].fx", "line 7"); empty for the whole file.
        value: what stands there, short; empty when nothing does.
        problem: what is wrong, with the limit.
        remedy: what to do.
    """

    file: str
    field: str
    value: str
    problem: str
    remedy: str

    @property
    def message(self) -> str:
        """One line: file, field, value, problem and remedy."""
        place = f"{self.file}: {self.field}" if self.field else self.file
        found = f" is {self.value}" if self.value and self.field else ""
        return f"{place}{found}: {self.problem}; {self.remedy}"


def shown(value: object) -> str:
    """A JSON value, short enough for one line of a message."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."


def violation_of(error: ClothTrackError, folder: Path, file: str, field: str = "") -> Violation:
    """What an error of this package says, as a violation of `file`."""
    text = str(error)
    for prefix in (f"{folder / file}: ", f"{folder}/"):
        text = text.removeprefix(prefix)
    problem, separator, remedy = text.rpartition("; ")
    if not separator:
        problem, remedy = text, "correct it"
    return Violation(file, field, "", problem, remedy)
