"""Limits of settings, declared in their annotations and checked in one place.

A configuration inherits from `Checked` and declares the limits of a field in its type:

    @dataclass(frozen=True)
    class SearchConfig(Checked):
        decay: Fraction = 0.7
        trials: Count = 10
        method: Literal["grid", "descent"] = "descent"

A value outside is refused in one line, such as "search.decay is 1.2; it must be above 0 and below
1". Conditions on several fields are checked by hand, in a `__post_init__` that calls the inherited
one first.
"""

import math
import re
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal, get_args, get_origin

from clothtrack.errors import InvalidConfigError


@dataclass(frozen=True)
class Bounds:
    """Limits of a finite number; None means no limit."""

    least: int | float | None = None
    most: int | float | None = None
    above: int | float | None = None
    below: int | float | None = None

    def holds(self, value: int | float) -> bool:
        """Return whether a value lies inside."""
        return (
            math.isfinite(value)
            and (self.least is None or value >= self.least)
            and (self.most is None or value <= self.most)
            and (self.above is None or value > self.above)
            and (self.below is None or value < self.below)
        )

    def __str__(self) -> str:
        """Return what a value must be, in words."""
        if self.least is not None and self.most is not None:
            return f"it must be from {self.least} to {self.most}"
        words = {
            "above": self.above,
            "at least": self.least,
            "below": self.below,
            "at most": self.most,
        }
        said = " and ".join(f"{word} {value}" for word, value in words.items() if value is not None)
        return f"it must be {said or 'finite'}"


@dataclass(frozen=True)
class Interval:
    """Limits of a pair of finite numbers, the smaller first.

    Attributes:
        least: smallest value of the first; None: any.
        most: largest value of the second; None: any.
    """

    least: int | float | None = None
    empty: bool = False
    most: int | float | None = None

    def holds(self, value: object) -> bool:
        """Return whether something is such an interval."""
        if not isinstance(value, tuple) or len(value) != 2 or not all(map(_is_number, value)):
            return False
        low, high = value
        rises = low <= high if self.empty else low < high
        limits = Bounds(least=self.least, most=self.most)
        return rises and limits.holds(low) and limits.holds(high)

    def __str__(self) -> str:
        """Return what a pair must be, in words."""
        from_least = "" if self.least is None else f"{self.least} <= "
        to_most = "" if self.most is None else f" <= {self.most}"
        rises = "<=" if self.empty else "<"
        return f"it must be (low, high) with {from_least}low {rises} high{to_most}"


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


Count = Annotated[int, Bounds(least=1)]
"""A whole number, 1 or more."""

Natural = Annotated[int, Bounds(least=0)]
"""A whole number, 0 or more."""

Positive = Annotated[float, Bounds(above=0)]
"""Any finite number above 0."""

NotNegative = Annotated[float, Bounds(least=0)]
"""Any finite number from 0 up."""

Share = Annotated[float, Bounds(least=0, most=1)]
"""A part of a whole, 0 and 1 included."""

Fraction = Annotated[float, Bounds(above=0, below=1)]
"""A part of a whole, 0 and 1 excluded."""


class Checked:
    """Base class of configurations that refuses values outside their declared limits."""

    def __post_init__(self) -> None:
        """Check every field with a declared limit."""
        for field in fields(self):
            if limit := _refused(field.type, getattr(self, field.name)):
                value = f"{getattr(self, field.name)!r:.120}"
                raise InvalidConfigError(f"{_group(type(self))}.{field.name} is {value}; {limit}")


def _refused(declared: Any, value: Any) -> str:
    """Return the declared limit that the value breaks, in words; empty if it breaks none."""
    if get_origin(declared) is Literal and value not in get_args(declared):
        return f"choose one of {', '.join(map(str, get_args(declared)))}"
    for limit in getattr(declared, "__metadata__", ()):
        if isinstance(limit, Bounds | Interval) and not limit.holds(value):
            return str(limit)
    return ""


def _group(owner: type) -> str:
    """Return the name of a class in settings, such as `template_fit` for `TemplateFitConfig`."""
    words = re.findall("[A-Z][a-z0-9]*", owner.__name__.removesuffix("Config"))
    return "_".join(words).lower()
