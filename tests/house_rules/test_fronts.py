"""Users of clothtrack import from fronts: `import clothtrack`, `from clothtrack.<room> import`.

A front is a package: clothtrack, a room, or a package inside a room. What lies behind is free to
change. Tests of behaviour obey as users do. A unit test of one module, which lies in the folder of
the module's room, may look behind the front of that room; so may a test of the command line's own
files. Experiments measure what no user asks for, and may look behind a front for what it lacks;
what it has they take from it.
"""

import ast
import json
import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src"
OBEYING = ("tests/end_to_end", "tests/examples", "tests/front", "tests/verification", "examples")
SCRIPTS = [path for folder in OBEYING for path in sorted((ROOT / folder).rglob("*.py"))]
RESEARCH = [
    path
    for folder in ("experiments", "tests/experiments", "benchmarks")
    for path in sorted((ROOT / folder).rglob("*.py"))
]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
IMPORT_LINE = re.compile(r"^ *(?:from clothtrack[\w.]* import|import clothtrack).*$", re.MULTILINE)


def behind_a_front(code):
    """The modules that code imports from although they are no fronts."""
    modules = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and node.module:
            modules.append(node.module)
        elif isinstance(node, ast.Import):
            modules += [one.name for one in node.names]
    ours = [one for one in modules if one.split(".")[0] == "clothtrack"]
    return [one for one in ours if not is_front(one)]


def is_front(module):
    if module == "clothtrack.errors":
        return True
    return (SOURCE / module.replace(".", "/") / "__init__.py").exists()


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_examples_and_tests_of_behaviour_import_from_fronts(path):
    assert behind_a_front(path.read_text("utf-8")) == []


@pytest.mark.parametrize("path", RESEARCH, ids=lambda path: str(path.relative_to(ROOT)))
def test_an_experiment_takes_from_a_front_what_it_has(path):
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and behind_a_front(ast.unparse(node)):
            room = ".".join(node.module.split(".")[:2])
            listed = {name.name for name in node.names} & set(import_module(room).__all__)
            assert not listed, f"line {node.lineno}: take {', '.join(sorted(listed))} from {room}"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_imports_the_front_alone(path):
    cells = json.loads(path.read_text("utf-8"))["cells"]
    code = "\n".join("".join(one["source"]) for one in cells if one["cell_type"] == "code")
    lines = re.findall(r"^.*\bimport clothtrack.*$", code, re.MULTILINE)
    assert lines == ["import clothtrack as ct"]
    assert "from clothtrack" not in code


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_a_page_shows_imports_from_fronts(path):
    lines = "\n".join(line.strip() for line in IMPORT_LINE.findall(path.read_text("utf-8")))
    assert behind_a_front(lines) == []
