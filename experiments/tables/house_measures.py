"""How large the house is: lines by room, public names, import depth, settings, documents, types.

    python experiments/house_measures.py CHECKOUT [CHECKOUT ...]

prints a Markdown table with a column per checkout: to compare a change with what was before it.
A name is public when neither it nor its module begins with an underscore. Import depth is the
longest chain of imports at module level. A setting is a leaf of the configuration that a verb can
change.
"""

import argparse
import ast
import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import _path  # noqa: F401

PACKAGE = "clothtrack"
LEAVES = """
import json, importlib, pkgutil, sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
import clothtrack

def leaves(value):
    if is_dataclass(value):
        return sum(leaves(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, Mapping) and value:
        return sum(map(leaves, value.values()))
    return 1

def named(name):
    for found in pkgutil.walk_packages(clothtrack.__path__, "clothtrack."):
        last = found.name.rpartition(".")[2]
        if last in sys.argv[1:]:
            module = importlib.import_module(found.name)
            if hasattr(module, name):
                return getattr(module, name)()

from clothtrack.cli import command_line
from clothtrack.cli.signature import options_of
verbs = command_line.VERBS
# In an older checkout these are functions, not what loads them.
functions = [verbs[name]() for name in verbs] if isinstance(verbs, Mapping) else verbs
options = sum(len(options_of(one) - {"-h", "--help", "--verbose"}) for one in functions)
found = {n: leaves(named(n)) for n in ("RunConfig", "FlattenConfig")}
print(json.dumps({**found, "verbs": len(verbs), "options": options}))
"""
HOMES = ("configuration", "pipeline", "run", "flatten_config")


def modules(checkout: Path) -> dict[str, ast.Module]:
    """Return the modules of all packages by dotted name, parsed."""
    source = checkout / "src"
    found = {}
    for path in sorted(source.rglob("*.py")):
        parts = path.relative_to(source).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found[name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


def imports(tree: ast.Module, known: dict[str, ast.Module]) -> set[str]:
    """The package's modules that a module imports at its top level."""
    found = set()
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGE):
            for name in node.names:
                full = f"{node.module}.{name.name}"
                found.add(full if full in known else node.module)
    return found & set(known)


def import_depth(known: dict[str, ast.Module], start: str | None = None) -> int:
    """Return the length of the longest chain of imports, of all modules or from one."""
    graph = {name: imports(tree, known) - {name} for name, tree in known.items()}

    @cache
    def depth(name: str) -> int:
        return 1 + max(map(depth, graph[name]), default=0)

    return max(map(depth, graph if start is None else graph[start]))


def public_nodes(known: dict[str, ast.Module]) -> list[ast.AST]:
    """Public functions, methods and classes."""
    found: list[ast.AST] = []
    for tree in known.values():
        for owner in (tree, *(n for n in tree.body if isinstance(n, ast.ClassDef))):
            if isinstance(owner, ast.ClassDef) and owner.name.startswith("_"):
                continue
            for node in owner.body:
                is_named = isinstance(node, ast.FunctionDef | ast.ClassDef)
                if is_named and not node.name.startswith("_"):
                    found.append(node)
    return found


def top_level_names(known: dict[str, ast.Module]) -> int:
    """Public functions, classes and constants of all modules."""
    count = 0
    for tree in known.values():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                count += not node.name.startswith("_")
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names = [t.id for t in targets if isinstance(t, ast.Name)]
                count += sum(not n.startswith("_") for n in names)
    return count


def front(known: dict[str, ast.Module]) -> int:
    """Names that `import clothtrack` promises."""
    for node in known[PACKAGE].body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return len(getattr(node.value, "elts", []))
    return 0


def typed_arguments(known: dict[str, ast.Module]) -> tuple[int, int]:
    """Arguments with an annotation, and all arguments."""
    typed = total = 0
    for tree in known.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                named = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                own = [a for a in named if a.arg not in ("self", "cls")]
                total += len(own)
                typed += sum(a.annotation is not None for a in own)
    return typed, total


def lines(folder: Path) -> int:
    """Lines of Python below a folder."""
    return sum(path.read_text(encoding="utf-8").count("\n") for path in folder.rglob("*.py"))


def settings(checkout: Path) -> dict[str, int]:
    """Leaves of the configuration behind `track` and `flatten`."""
    environment = {**os.environ, "PYTHONPATH": str(checkout.resolve() / "src")}
    output = subprocess.run(
        [sys.executable, "-c", LEAVES, *HOMES], env=environment, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    return json.loads(output.stdout.splitlines()[-1])


def measures(checkout: Path) -> dict[str, str]:
    """Every figure of one checkout by its name."""
    known = modules(checkout)
    source = checkout / "src" / PACKAGE
    nodes, (typed, total) = public_nodes(known), typed_arguments(known)
    documented = sum(ast.get_docstring(node) is not None for node in nodes)
    src, tests = lines(source), lines(checkout / "tests")
    leaves = settings(checkout)
    rows = {
        "modules": f"{len(known)}",
        "lines of src": f"{lines(checkout / 'src'):,}",
        "lines of the core": f"{src:,}",
        "loose files in the root": f"{len(list(source.glob('*.py')))}",
        "names that the front promises": f"{front(known)}",
        "public names in all modules": f"{top_level_names(known)}",
        "import depth, modules": f"{import_depth(known)}",
        "below `tracking/algorithm.py`": f"{import_depth(known, f'{PACKAGE}.tracking.algorithm')}",
        "settings reachable from `track`": f"{leaves['RunConfig']}",
        "settings reachable from `flatten`": f"{leaves['FlattenConfig']}",
        "verbs": f"{leaves['verbs']}",
        "options": f"{leaves['options']}",
        "public docs": f"{documented} of {len(nodes)}",
        "typed arguments": f"{typed} of {total}",
        "tests / src, lines": f"{tests / src:.2f}",
    }
    rooms = [path for path in source.iterdir() if (path / "__init__.py").exists()]
    rooms += [path for path in source.parent.glob(f"{PACKAGE}_*") if path.is_dir()]
    rows |= {f"lines of `{room.name}`": f"{lines(room):,}" for room in sorted(rooms)}
    return rows


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkouts", nargs="+", type=Path)
    options = parser.parse_args()
    columns = [measures(checkout) for checkout in options.checkouts]
    names = list(dict.fromkeys(name for column in columns for name in column))
    rows = [("", *(one.name for one in options.checkouts)), ("---", *["---:"] * len(columns))]
    rows += [(name, *(column.get(name, "-") for column in columns)) for name in names]
    table = [f"| {' | '.join(row)} |" for row in rows]
    sys.stdout.write("\n".join(table) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
