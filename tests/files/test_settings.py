"""Settings change what they name, and nothing else."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.files.settings import with_settings


@dataclass(frozen=True)
class Inner:
    count: int = 3
    rate: float = 0.5
    on: bool = True
    kind: str = "a"
    gravity: tuple[float, ...] = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class Outer:
    inner: Inner = field(default_factory=Inner)
    parameters: Mapping[str, float] = field(default_factory=lambda: {"friction": 0.5})


def test_no_setting_changes_nothing():
    assert with_settings(Outer(), []) == Outer()


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("inner.count=7", Outer(inner=Inner(count=7))),
        ("inner.rate=2", Outer(inner=Inner(rate=2.0))),
        ("inner.on=false", Outer(inner=Inner(on=False))),
        ("inner.on=False", Outer(inner=Inner(on=False))),
        ("inner.kind=halving", Outer(inner=Inner(kind="halving"))),
        ("inner.gravity=[0, 0, -1]", Outer(inner=Inner(gravity=(0, 0, -1)))),
        ("parameters.friction=0.1", Outer(parameters={"friction": 0.1})),
    ],
)
def test_one_setting_changes_one_value(setting, expected):
    assert with_settings(Outer(), [setting]) == expected


def test_later_settings_win():
    assert with_settings(Outer(), ["inner.count=1", "inner.count=2"]).inner.count == 2


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("inner.count", "no value"),
        ("inner.size=1", "known are count, rate"),
        ("parameters.bounce=1", "known are friction"),
        ("inner.count=1.5", "cannot replace 3"),
        ("inner.count=true", "cannot replace 3"),
        ("inner.on=1", "cannot replace True"),
        ("inner.rate=fast", "cannot replace 0.5"),
        ("inner=3", "cannot replace"),
        ("inner.count.more=1", "nothing below"),
    ],
)
def test_a_wrong_setting_says_what_is_allowed(setting, told):
    with pytest.raises(InvalidConfigError, match=told):
        with_settings(Outer(), [setting])
