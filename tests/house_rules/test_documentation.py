"""What the documents name exists: functions, files, verbs and their options."""

import inspect
import re
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path

import pytest

from clothtrack.cli import command_line as cli

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
NAMED = re.compile(r"`((?:\w+/)*\w+\.py): ([\w.]+)`")
LINK = re.compile(r"\]\((?!https?:)([^)#]+)[^)]*\)")
COMMAND = re.compile(r"^    (?:\.venv/bin/)?clothtrack ([\w-]+)(.*)$", re.MULTILINE)
VERBS = {verb.__name__.replace("_", "-"): verb for verb in cli.VERBS}
OTHER_NAMES = {"settings": "set"}


def ids(path):
    return str(path.relative_to(ROOT))


def known_options(verb):
    """Names of a verb's options; one that is a dataclass stands for its fields."""
    for name, option in inspect.signature(VERBS[verb]).parameters.items():
        if is_dataclass(option.annotation):
            yield from (field.name for field in fields(option.annotation))
        else:
            yield name


def defines(path, name):
    """Whether a module has a name, or one of its classes a method or attribute of this name."""
    module = import_module("clothtrack." + path.removesuffix(".py").replace("/", "."))
    owners = [module, *(kind for _, kind in inspect.getmembers(module, inspect.isclass))]
    head, _, tail = name.partition(".")
    for owner in owners:
        found = getattr(owner, head, None)
        if found is None:
            continue
        if not tail or hasattr(found, tail) or tail in getattr(found, "__annotations__", {}):
            return True
    return False


@pytest.mark.parametrize(
    ("path", "name"), sorted(set(NAMED.findall((ROOT / "docs" / "method.md").read_text())))
)
def test_a_line_of_the_method_is_a_function(path, name):
    assert (ROOT / "src" / "clothtrack" / path).exists()
    assert defines(path, name)


@pytest.mark.parametrize("document", DOCUMENTS, ids=ids)
def test_links_lead_somewhere(document):
    for target in LINK.findall(document.read_text()):
        assert (document.parent / target).exists(), target


@pytest.mark.parametrize("document", DOCUMENTS, ids=ids)
def test_commands_and_options_exist(document):
    for verb, rest in COMMAND.findall(document.read_text()):
        assert verb in VERBS, verb
        options = {OTHER_NAMES.get(name, name).replace("_", "-") for name in known_options(verb)}
        for option in re.findall(r"--([\w-]+)", rest):
            assert option in options, f"{verb} --{option}"


def test_one_table_has_every_verb_once():
    text = (ROOT / "docs" / "cli.md").read_text()
    named = re.findall(r"^\| `clothtrack ([\w-]+)", text, re.MULTILINE)
    assert sorted(named) == sorted(VERBS)


def test_the_table_says_which_verbs_write_json():
    text = (ROOT / "docs" / "cli.md").read_text()
    told = dict(re.findall(r"^\| `clothtrack ([\w-]+).*\| (\w*) *\|$", text, re.MULTILINE))
    for name, verb in VERBS.items():
        writes = "json" in inspect.signature(inspect.unwrap(verb)).parameters
        assert told[name] == ("yes" if writes else ""), name


def test_the_readme_shows_the_first_verbs_and_leads_to_the_others():
    text = (ROOT / "README.md").read_text()
    for name in ("demo", "import", "track", "evaluate", "view"):
        assert f"`clothtrack {name}" in text
    assert "(docs/cli.md)" in text
