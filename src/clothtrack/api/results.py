"""What comes of a verb: `text()` for a person and `as_dict()` for a program.

`doubts` are lines about what may be wrong, and `exit_code` is what the command line ends with.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Item = TypeVar("Item")


@dataclass(frozen=True)
class Result:
    """What came of a verb, in words.

    Attributes:
        words: for a person.
        report: the same as JSON holds it.
        doubts: what may be wrong, and what to do about it.
        exit_code: of the command line.
    """

    words: str
    report: Any
    doubts: tuple[str, ...] = ()
    exit_code: int = 0

    def text(self) -> str:
        """Return it for a person."""
        return self.words

    def as_dict(self) -> Any:
        """Return it as JSON holds it."""
        return self.report


@dataclass(frozen=True)
class Many(Generic[Item]):
    """What came of each of many things.

    Attributes:
        each: what came of each, in order.
    """

    each: tuple[Item, ...]

    def __iter__(self) -> Iterator[Item]:
        """Give what came of each."""
        return iter(self.each)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What may be wrong with any of them."""
        return tuple(doubt for one in self.each for doubt in getattr(one, "doubts", ()))

    @property
    def exit_code(self) -> int:
        """1 where something is wrong with one of them."""
        return 0 if all(getattr(one, "ok", True) for one in self.each) else 1

    def text(self) -> str:
        """Return all for a person; nothing of those that only have doubts."""
        return "\n".join(filter(None, (one.text() for one in self.each)))

    def as_dict(self) -> list[Any]:
        """Return all as JSON holds them."""
        return [one.as_dict() for one in self.each]
