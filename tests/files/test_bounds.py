"""Limits in annotations refuse what lies outside, in a line that says what is allowed."""

import math
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Literal

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import (
    Bounds,
    Checked,
    Count,
    Fraction,
    Interval,
    Natural,
    NotNegative,
    Positive,
    Share,
)


@dataclass(frozen=True)
class LineSearchConfig(Checked):
    decay: Fraction = 0.7
    trials: Count = 10
    retries: Natural = 0
    speed: Positive = 1.0
    weight: NotNegative = 0.0
    rank: Share = 0.0
    strength: Annotated[float, Bounds(above=0, most=1)] = 1.0
    views: Annotated[int, Bounds(least=1, most=16)] = 1
    offset: Annotated[float, Bounds()] = -1.0
    range_m: Annotated[tuple[float, float], Interval(least=0)] = (0.0, 1.0)
    lift_m: Annotated[tuple[float, float], Interval(empty=True)] = (-1.0, -1.0)
    method: Literal["grid", "descent"] = "grid"
    free: float = math.inf


def test_values_at_their_limits_are_taken():
    limits = {"strength": 1.0, "views": 16, "rank": 1.0, "retries": 0, "trials": 1}
    assert asdict(LineSearchConfig(**limits)) == {**asdict(LineSearchConfig()), **limits}


@pytest.mark.parametrize(
    ("field", "value", "limit"),
    [
        ("decay", 1.2, "it must be above 0 and below 1"),
        ("decay", 0.0, "it must be above 0 and below 1"),
        ("decay", 1.0, "it must be above 0 and below 1"),
        ("trials", 0, "it must be at least 1"),
        ("retries", -1, "it must be at least 0"),
        ("speed", 0.0, "it must be above 0"),
        ("speed", math.inf, "it must be above 0"),
        ("weight", -0.1, "it must be at least 0"),
        ("weight", math.nan, "it must be at least 0"),
        ("rank", 1.1, "it must be from 0 to 1"),
        ("strength", 0.0, "it must be above 0 and at most 1"),
        ("views", 17, "it must be from 1 to 16"),
        ("offset", math.nan, "it must be finite"),
        ("range_m", (1.0, 1.0), "it must be (low, high) with 0 <= low < high"),
        ("range_m", (-1.0, 1.0), "it must be (low, high) with 0 <= low < high"),
        ("range_m", (0.0, math.inf), "it must be (low, high) with 0 <= low < high"),
        ("lift_m", (0.0, -1.0), "it must be (low, high) with low <= high"),
        ("method", "halving", "choose one of grid, descent"),
    ],
)
def test_a_value_outside_is_refused_with_its_name_and_its_limit(field, value, limit):
    with pytest.raises(InvalidConfigError) as refused:
        replace(LineSearchConfig(), **{field: value})
    assert str(refused.value) == f"line_search.{field} is {value!r}; {limit}"


@pytest.mark.parametrize("value", [(1.0,), (1, 2, 3), "ab", (None, 1), (0.2, 0.1), (0, 1e308), 3])
def test_what_is_no_pair_of_numbers_in_order_is_no_interval(value):
    assert not Interval(least=0, empty=True, most=10).holds(value)
    assert str(Interval(least=0, most=10)) == "it must be (low, high) with 0 <= low < high <= 10"
