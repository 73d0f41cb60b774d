"""Users of clothtrack import from fronts: `import clothtrack`, `from clothtrack.<room> import`.

A front is a package: clothtrack, a room, or a package inside a room. What lies behind is free to
change. Tests of behavior import as users do. Unit tests and experiments may look behind a front.
"""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src"
OBEYING = ("tests/end_to_end", "tests/examples", "tests/api", "tests/verification", "examples")
SCRIPTS = [path for folder in OBEYING for path in sorted((ROOT / folder).rglob("*.py"))]
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
    ours = [one for one in modules if one.split(".")[0].startswith("clothtrack")]
    return [one for one in ours if not is_front(one)]


def is_front(module):
    if module == "clothtrack.errors":
        return True
    return (SOURCE / module.replace(".", "/") / "__init__.py").exists()


def test_examples_and_tests_of_behavior_import_from_fronts():
    found = {path.name: behind_a_front(path.read_text("utf-8")) for path in SCRIPTS}
    assert not {name: modules for name, modules in found.items() if modules}


def test_a_page_shows_imports_from_fronts():
    for path in PAGES:
        lines = "\n".join(line.strip() for line in IMPORT_LINE.findall(path.read_text("utf-8")))
        assert behind_a_front(lines) == [], path.name
