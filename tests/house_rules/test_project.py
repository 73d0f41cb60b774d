"""Rules about the project as a whole: direction of imports, change log, versions, references."""

import re
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
VERSION = PROJECT["version"]


def test_one_version():
    front = (ROOT / "src/clothtrack/version.py").read_text("utf-8")
    assert f'__version__ = "{VERSION}"' in front
    assert f"version: {VERSION}" in (ROOT / "CITATION.cff").read_text("utf-8")


def test_every_requirement_has_a_known_good_version():
    text = (ROOT / "constraints.txt").read_text("utf-8")
    pinned = {
        re.split(r"==", line)[0].lower().replace("_", "-")
        for line in text.splitlines()
        if line and not line.startswith("#")
    }
    extras = PROJECT["optional-dependencies"].values()
    wanted = [*PROJECT["dependencies"], *(one for extra in extras for one in extra)]
    names = {re.split(r"[\[<>=!~ ;]", one)[0].lower().replace("_", "-") for one in wanted}
    # One extra may bring another: its requirements are in the list themselves.
    names.discard(PROJECT["name"])
    assert names <= pinned, f"constraints.txt lacks {sorted(names - pinned)}"


def test_tracking_needs_no_torch():
    assert not any(one.startswith("torch") for one in PROJECT["dependencies"])


def test_the_command_is_installed_with_the_package():
    try:
        scripts = metadata.distribution("clothtrack").entry_points
    except metadata.PackageNotFoundError:
        pytest.skip("clothtrack runs from its source folder here, not installed")
    assert {one.name for one in scripts} >= {"clothtrack", "import"}


def test_nobody_is_told_to_install_a_name_that_no_registry_has():
    places = [*ROOT.glob("*.md"), ROOT / "Makefile"]
    for folder in ("src", "docs", "experiments", "benchmarks", "examples"):
        places += (ROOT / folder).rglob("*.*")
    telling = re.compile(r"pip install[^\n]*clothtrack|clothtrack\[")
    told = [
        f"{place.relative_to(ROOT)}: {found.group()}"
        for place in places
        if place.suffix in (".md", ".py", ".ipynb", ".html", "") and place.is_file()
        for found in telling.finditer(place.read_text("utf-8"))
    ]
    assert told == []
