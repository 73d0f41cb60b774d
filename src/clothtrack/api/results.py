"""Results of verbs: `text()` for a person and `as_dict()` for a program.

`doubts` are lines about possible problems, and `exit_code` is that of the command line.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from clothtrack._shown import short_repr

Item = TypeVar("Item")


@dataclass(frozen=True)
class Result:
    """The result of a verb, as text.

    Attributes:
        words: the text for a person.
        report: the same as JSON-compatible values.
        doubts: possible problems, with remedies.
        exit_code: exit code of the command line.
    """

    words: str
    report: Any
    doubts: tuple[str, ...] = ()
    exit_code: int = 0

    __repr__ = short_repr

    def text(self) -> str:
        """Return the text for a person."""
        return self.words

    def as_dict(self) -> Any:
        """Return the same as JSON-compatible values."""
        return self.report


@dataclass(frozen=True)
class Many(Generic[Item]):
    """The results of many items.

    Attributes:
        each: the result of each item, in order.
    """

    each: tuple[Item, ...]

    __repr__ = short_repr

    def __iter__(self) -> Iterator[Item]:
        """Iterate over the results."""
        return iter(self.each)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Possible problems of all items."""
        return tuple(doubt for one in self.each for doubt in getattr(one, "doubts", ()))

    @property
    def exit_code(self) -> int:
        """1 if something is wrong with one of them."""
        return 0 if all(getattr(one, "ok", True) for one in self.each) else 1

    def text(self) -> str:
        """Return the texts of all items; those that only have doubts have none."""
        return "\n".join(filter(None, (one.text() for one in self.each)))

    def as_dict(self) -> list[Any]:
        """Return all results as JSON-compatible values."""
        return [one.as_dict() for one in self.each]
