"""One thing that is wrong with a recording: where, what, and what to do about it."""

import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from clothtrack.errors import ClothTrackError

DOCUMENT = "recording.json"

_NUMBER = re.compile(r"\d+(?:\.\d+)?")


@dataclass(frozen=True)
class Violation:
    """One thing that is wrong with a recording.

    Attributes:
        field: where in the file ("cameras[0].fx", "line 7"); empty for the whole file.
        value: the value found there, shortened; empty if there is none.
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
        value = f" is {self.value}" if self.value and self.field else ""
        return f"{place}{value}: {self.problem}; {self.remedy}"


class Violations(list[Violation]):
    """Everything that is wrong with a recording, in the order in which it is found."""

    def add(self, field: str, value: str, words: str, *, file: str = DOCUMENT) -> None:
        """Add a violation."""
        problem, _, remedy = words.rpartition("; ")
        self.append(Violation(file, field, value, problem, remedy))

    @contextmanager
    def of_errors(self, folder: Path, file: str, field: str = "") -> Iterator[None]:
        """Add an error of this package that is raised in the block as a violation.

        It belongs to the file in the folder that the error names, or else to `file`.
        """
        try:
            yield
        except ClothTrackError as error:
            text = str(error)
            if text.startswith(f"{folder}/"):
                file, _, text = text.removeprefix(f"{folder}/").partition(": ")
            self.add(field, "", text if "; " in text else f"{text}; correct it", file=file)


def grouped(violations: Sequence[Violation]) -> list[str]:
    """Return one line per cause, however many files it concerns."""
    alike: dict[tuple[str, ...], list[Violation]] = {}
    for one in violations:
        key = tuple(_NUMBER.sub("#", part) for part in (one.file, one.field, one.problem))
        alike.setdefault(key, []).append(one)
    return [
        same[0].message if len(same) == 1 else f"{len(same)} alike, the first: {same[0].message}"
        for same in alike.values()
    ]


def shown(value: object) -> str:
    """Return a JSON value, short enough for one line of a message."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."
