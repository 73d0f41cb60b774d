"""What the documents name exists: functions, files, verbs and their options."""

import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest

from clothtrack.cli import command_line as cli
from clothtrack.cli import signature

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), ROOT / "experiments" / "README.md"]
)
PRESENT = [
    path for path in DOCUMENTS if path.parent.name != "notebook" and path.name != "CHANGELOG.md"
]
"""What is there today; the notebook and the changelog also name what is gone."""
NAMED = re.compile(r"`((?:\w+/)*\w+\.py): ([\w.]+)`")
LINK = re.compile(r"\]\((?![a-z]+:)([^)#\s]*)#?([^)\s]*)\)")
COMMAND = re.compile(r"(?:^    (?:\S*/)?|`)clothtrack ([a-z][\w-]*)([^`\n]*)", re.MULTILINE)
FLAG = re.compile(r"(?<![\w-])--([a-z][\w-]*)")
SETTING = re.compile(r"--set ([a-z][\w.]*)=|`(?!dotted\.name)(\w+(?:\.\w+)+)(=[^`]*)?`")
RECORDED = {"cloth", "template"}
"""Groups of settings that share their names with parts of recording.json."""
VERBS = {name: load() for name, load in cli.VERBS.items()}


def ids(path):
    return str(path.relative_to(ROOT))


def text_of(document):
    """The text, each command in one line."""
    return re.sub(r" *\\\n +", " ", document.read_text("utf-8"))


def options_of(verb):
    """Options of a verb as they are written, without dashes."""
    return {written.lstrip("-") for written in signature.options_of(VERBS[verb])}


def known_settings():
    """Every name that some verb takes with --set."""
    from clothtrack.files.settings import settings_of
    from clothtrack.planning.flatten_config import FlattenConfig
    from clothtrack.reconstruction.data.states import StatesConfig
    from clothtrack.reconstruction.tokens.learning_config import LearningConfig
    from clothtrack.tracking.configuration import RunConfig
    from clothtrack_lab.graph_dynamics.mesh_training import DynamicsTrainingConfig
    from clothtrack_lab.graph_dynamics.roll_outs import RollOutConfig
    from clothtrack_lab.published_networks.published_config import PublishedConfig
    from clothtrack_lab.world.episodes import EpisodeConfig

    configs = [
        RunConfig(), FlattenConfig(), DynamicsTrainingConfig(), LearningConfig.preset("pretrain"),
        PublishedConfig.preset("pretrain"), StatesConfig(), EpisodeConfig(),
    ]  # fmt: skip
    names = {setting.name for config in configs for setting in settings_of(config)}
    names |= {setting.name for setting in settings_of(RollOutConfig(), "roll_outs")}
    return names


def anchors_of(page):
    """What a link to a page can lead to: its headings, as GitHub and MkDocs name them, and ids."""
    text = page.read_text("utf-8")
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    plain = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading) for heading in headings]
    slugs = [
        re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in plain
    ]
    return {*slugs, *re.findall(r'(?:id|name)="([^"]+)"', text)}


def defines(path, name):
    """Whether a module has a name, or one of its classes a method or attribute of this name."""
    package = "" if path.startswith("clothtrack_") else "clothtrack."
    module = import_module(package + path.removesuffix(".py").replace("/", "."))
    owners = [module, *(kind for _, kind in inspect.getmembers(module, inspect.isclass))]
    head, _, tail = name.partition(".")
    for owner in owners:
        found = getattr(owner, head, None)
        if found is None:
            continue
        if not tail or hasattr(found, tail) or tail in getattr(found, "__annotations__", {}):
            return True
    return False


def test_a_line_of_the_method_is_a_function():
    named = sorted(set(NAMED.findall((ROOT / "docs" / "method.md").read_text())))
    assert len(named) > 20
    assert not [f"{path}: {name}" for path, name in named if not defines(path, name)]


def test_links_lead_somewhere():
    wrong = []
    for document in DOCUMENTS:
        for target, anchor in LINK.findall(document.read_text("utf-8")):
            page = document.parent / target if target else document
            if not page.exists() or (anchor and anchor not in anchors_of(page)):
                wrong.append(f"{ids(document)}: {target}#{anchor}")
    assert not wrong


def test_commands_and_options_exist():
    wrong = []
    for document in PRESENT:
        for verb, rest in COMMAND.findall(text_of(document)):
            options = options_of(verb) if verb in VERBS else set()
            unknown = [o for o in FLAG.findall(rest.partition(" #")[0]) if o not in options]
            if verb not in VERBS or unknown:
                wrong.append(f"{ids(document)}: {verb} {unknown}")
    assert not wrong


def test_settings_exist():
    pytest.importorskip("torch")
    known = known_settings()
    heads = {name.partition(".")[0] for name in known if "." in name}
    wrong = []
    for document in PRESENT:
        for written, named, value in SETTING.findall(text_of(document)):
            name = written or named
            is_setting = written or value or name.partition(".")[0] in heads - RECORDED
            if is_setting and not any(f"{one}.".startswith(f"{name}.") for one in known):
                wrong.append(f"{ids(document)}: {name}")
    assert not wrong


def test_files_of_the_project_exist():
    folders = "|".join(path.name for path in ROOT.iterdir() if path.is_dir())
    wrong = []
    for document in PRESENT:
        for path in re.findall(rf"`((?:{folders})/[\w./-]+)`", document.read_text("utf-8")):
            written_later = path.startswith("out/") or re.search(r"\b[A-Z]+\b", path)
            if not written_later and not (ROOT / path).exists():
                wrong.append(f"{ids(document)}: {path}")
    assert not wrong


def test_one_table_has_every_verb_once():
    text = (ROOT / "docs" / "cli.md").read_text()
    named = re.findall(r"^\| `clothtrack ([\w-]+)", text, re.MULTILINE)
    assert sorted(named) == sorted(VERBS)
