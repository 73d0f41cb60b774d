"""What comes of setting up a recording, in words and for a program."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class SetUp:
    """What was found, or written.

    Attributes:
        words: the same in lines, for a person.
        report: the same as JSON holds it.
        doubts: what may be wrong, and what to do about it.
    """

    words: str
    report: dict[str, Any]
    doubts: tuple[str, ...] = ()

    def text(self) -> str:
        """Return it for a person."""
        return self.words

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON holds it."""
        return self.report
