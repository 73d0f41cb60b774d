"""Rules about the source that no tool has; a failure names every file, line and reason."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = sorted(path for path in (ROOT / "src").iterdir() if (path / "__init__.py").exists())
MODULES = sorted(module for package in PACKAGES for module in package.rglob("*.py"))
TEXTS = sorted(
    path
    for folder in ("tests", "examples", "experiments", "benchmarks", "docs", "src")
    for suffix in ("*.py", "*.md", "*.ipynb")
    for path in (ROOT / folder).rglob(suffix)
)


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def trees():
    return [(name_of(path), ast.parse(path.read_text(encoding="utf-8"))) for path in MODULES]


def test_only_our_own_errors_are_raised():
    """A person can only act on an error of clothtrack.errors."""
    errors = ast.parse((ROOT / "src" / "clothtrack" / "errors.py").read_text(encoding="utf-8"))
    ours = {node.name for node in errors.body if isinstance(node, ast.ClassDef)}
    # Python itself asks for it where a package has no such name (PEP 562).
    ours |= {"AttributeError"}
    wrong = []
    for name, tree in trees():
        allowed = ours | caught_in(tree)
        for node in ast.walk(tree):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                raised = ast.unparse(node.exc.func).rpartition(".")[2]
                if raised[:1].isupper() and raised not in allowed:
                    wrong.append(f"{name}:{node.lineno} raises {raised}")
    assert not wrong


def caught_in(tree: ast.Module) -> set[str]:
    """What a module raises and catches itself never reaches anybody."""
    caught = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ExceptHandler) and node.type is not None:
            types = node.type.elts if isinstance(node.type, ast.Tuple) else [node.type]
            caught |= {ast.unparse(one) for one in types}
    return caught


def test_no_machine_is_named():
    pattern = re.compile(r"(?<![\w.])/(?:home|Users|work|root)/\w+")
    files = [*TEXTS, *ROOT.glob("*.md"), ROOT / "Makefile"]
    wrong = [
        f"{name_of(path)}: {found[0]}"
        for path in files
        if path != Path(__file__) and (found := pattern.search(path.read_text(encoding="utf-8")))
    ]
    assert not wrong
