"""Wrong usage is one line that names what may have been meant; help has no empty words."""

import importlib.metadata
import io
import json
import logging
import re

import pytest

from clothtrack.cli import command_line as cli
from clothtrack.cli.terminal import say
from clothtrack.cli.warnings_once import logged
from clothtrack.version import __version__

VERBS = {name: load() for name, load in cli.VERBS.items()}


def helped(verb, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main([verb, "--help"])
    assert end.value.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "say what to do: clothtrack VERB"),
        (["trak", "rec"], "trak is no verb; did you mean track?"),
        (
            ["calibrate_camera", "rec"],
            "did you mean calibrate-camera?",
        ),
        (["track", "--output", "x"], "no recordings given; name at least one"),
        (["qqq"], "qqq is no verb; clothtrack --help lists the verbs"),
        (["--json"], "--json is no option; options stand behind the verb"),
        (["track", "rec", "--ouput", "x"], "--ouput is no option of track; did you mean --output?"),
        (["import", "a", "b", "--depth-unt-m=1"], "did you mean --depth-unit-m?"),
        (["view", "x", "--qqq"], "--qqq is no option of view; clothtrack view --help lists them"),
        (
            ["track", "x", "--output", "y", "--mode", "best"],
            "invalid choice 'best' for argument '--mode'",
        ),
        (["export"], "Missing from clothtrack export: RUN, --output PATH;"),
        (["import"], "Missing from clothtrack import: SOURCE, RECORDING;"),
        (["simulate", "x", "--states", "few"], "--states INT cannot be 'few'"),
        (["segment", "x", "--click", "3"], "--click COLUMN ROW cannot be '3'"),
        (["track", "--output"], "Missing value for argument '--output'"),
        (["export", "a", "b", "--output", "x"], "Unrecognized options: b"),
    ],
)
def test_wrong_usage_is_one_line(words, told, capsys):
    assert cli.main(words) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("clothtrack: ")
    assert shown.err.count("\n") == 1
    assert told in shown.err


def test_what_a_terminal_cannot_show_is_escaped(monkeypatch):
    shown = io.BytesIO()
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(shown, encoding="ascii"))
    say("Zürich \ud800")
    assert shown.getvalue() == rb"Z\xfcrich \ud800" + b"\n"


@pytest.mark.parametrize("verb", VERBS)
def test_help_says_nothing_empty(verb, capsys):
    text = helped(verb, capsys)
    for empty in ("(default: )", "None", "''", "(default: True)", "(default: False)"):
        assert empty not in text
    assert "--verbose" in text
    assert "--json" in text


def test_the_version_comes_with_commit_devices_and_packages(capsys):
    assert cli.main(["--version"]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"clothtrack {__version__}")
    assert re.search(r"^devices +cpu", said, re.MULTILINE)
    assert f"numpy {importlib.metadata.version('numpy')}" in said
    assert cli.main(["--version", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["clothtrack"] == __version__
    assert "commit" in found
    assert found["devices"][0] == "cpu"


def test_a_defect_of_ours_is_not_taken_for_wrong_usage(monkeypatch):
    """What parses options takes a ValueError for a wrong one."""

    def fail() -> None:
        """Fail."""
        raise ValueError("ours")

    monkeypatch.setattr(cli, "VERBS", {"fail": lambda: fail})
    with pytest.raises(ValueError, match="ours"):
        cli.main(["fail"])


def test_one_cause_is_one_warning_and_a_count(capsys):
    log = logging.getLogger("clothtrack.test")
    with logged(verbose=False):
        for frame in range(27):
            log.warning("frame %d of towel_0001: no cloud (color/%04d.png: no blue)", frame, frame)
        for _ in range(2):
            log.warning("picker tip never closes")
        log.warning("frame 3 of towel_0002: no cloud (color/0003.png: no blue)")
        log.info("not asked for")
    assert capsys.readouterr().err.splitlines() == [
        "WARNING frame 0 of towel_0001: no cloud (color/0000.png: no blue)",
        "WARNING picker tip never closes",
        "WARNING frame 3 of towel_0002: no cloud (color/0003.png: no blue)",
        "26 more like this: WARNING frame 0 of towel_0001: no cloud (color/0000.png: no blue)",
    ]
