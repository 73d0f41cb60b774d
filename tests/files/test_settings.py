"""Settings change what they name, and nothing else."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.files.bounds import Checked, Positive
from clothtrack.files.settings import settings_of, with_settings


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


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("inner.count", "no value"),
        ("inner.size=1", "known are count, rate"),
        ("count=1", r"did you mean inner\.count\?"),
        ("iner.count=1", r"did you mean inner\.count\?"),
        ("inner.coutn=1", r"did you mean inner\.count\?"),
        ("parameters.bounce=1", "known are friction"),
        ("inner.count=1.5", "cannot replace 3, which is a whole number"),
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


@dataclass(frozen=True)
class Told:
    """A class whose attributes are described.

    Attributes:
        rate: how often [1/s],
            e.g. 0.5. The rest is a second thought.
        low, high: both ends.
        shares: of each kind.
    """

    rate: float = 0.5
    inner: Inner = field(default_factory=Inner)
    low: float = 0.0
    high: float = 1.0
    table: Inner | None = None
    shares: Mapping[str, float] = field(default_factory=lambda: {"flat": 1.0})


def test_settings_are_listed_with_value_and_meaning_group_by_group():
    listed = list(settings_of(Told()))
    assert [one.group for one in listed] == [""] * 3 + ["inner"] * 5 + ["shares"]
    assert listed[0] == ("", "rate", "0.5", "how often [1/s], e.g. 0.5")
    assert [one.meaning for one in listed[1:3]] == ["both ends", "both ends"]
    assert listed[-1] == ("shares", "shares.flat", "1.0", "of each kind")


def test_every_listed_setting_can_be_given_back_as_it_is_written():
    words = [f"{one.name}={one.value}" for one in settings_of(Told())]
    assert with_settings(Told(), words) == Told()


@pytest.mark.parametrize("text", ["9" * 5000, "[" * 5000])
def test_what_json_cannot_read_is_a_text(text):
    assert with_settings(Outer(), [f"inner.kind={text}"]).inner.kind == text
    with pytest.raises(InvalidConfigError, match="cannot replace 3") as refused:
        with_settings(Outer(), [f"inner.count={text}"])
    assert len(str(refused.value)) < 300


def test_a_limit_is_told_of_the_setting_as_it_was_written():
    @dataclass(frozen=True)
    class PieceRanges(Checked):
        size_m: Positive = 1.0

    @dataclass(frozen=True)
    class WholeConfig:
        part: PieceRanges = field(default_factory=PieceRanges)

    @dataclass(frozen=True)
    class Settings:
        whole: WholeConfig = field(default_factory=WholeConfig)

    with pytest.raises(
        InvalidConfigError, match=r"^whole\.part\.size_m is -1\.0; it must be above"
    ):
        with_settings(Settings(), ["whole.part.size_m=-1"])
