"""Count the project and fail above `budget.toml`: the size may only fall.

    python tests/house_rules/budget.py            the table; exit code 1 above a budget
    python tests/house_rules/budget.py --lower    lower the budgets to what is there, raise none

Code is what is no blank line, comment, docstring or import. A budget is raised by hand, in a commit
whose message names what pays for it elsewhere.
"""

import argparse
import ast
import sys
import tomllib
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCRIPTS = ("tests", "experiments", "benchmarks")
PAGES, WORDS = "pages (js, html, css)", "words (README, docs)"


def split(text: str) -> tuple[int, int]:
    """Return all lines, and those of code, of a Python file."""
    lines, other = text.splitlines(), set[int]()
    for node in ast.walk(ast.parse(text)):
        found: list[ast.stmt] = []
        if isinstance(node, ast.Import | ast.ImportFrom):
            found = [node]
        elif isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            found = [one for one in node.body if is_text(one)]
        for one in found:
            other.update(range(one.lineno, (one.end_lineno or one.lineno) + 1))
    code = sum(
        bool(line.strip()) and not line.strip().startswith("#") and number not in other
        for number, line in enumerate(lines, 1)
    )
    return len(lines), code


def is_text(node: ast.stmt) -> bool:
    """Whether a statement is a text alone: a docstring, or a remark under an attribute."""
    constant = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return constant and isinstance(node.value.value, str)


def total(files: Iterable[Path]) -> list[int]:
    """Return the lines of Python files, and those of code."""
    counts = [split(file.read_text(encoding="utf-8")) for file in files]
    return [sum(all_lines for all_lines, _ in counts), sum(code for _, code in counts)]


def counted(root: Path) -> dict[str, list[int]]:
    """Return lines and lines of code of each folder; lines alone of pages, and the words."""
    found = {}
    for package in sorted((root / "src").iterdir()):
        if any(package.glob("*.py")):
            found[f"src/{package.name}"] = total(package.glob("*.py"))
            for folder in sorted(one for one in package.iterdir() if any(one.rglob("*.py"))):
                found[f"src/{package.name}/{folder.name}"] = total(folder.rglob("*.py"))
    found["src"] = total((root / "src").rglob("*.py"))
    found |= {name: total((root / name).rglob("*.py")) for name in SCRIPTS}
    pages = [
        page.read_text("utf-8")
        for kind in ("js", "html", "css")
        for page in (root / "src").rglob(f"*.{kind}")
        if "shipped" not in page.parts
    ]
    texts = [root / "README.md", *(root / "docs").rglob("*.md")]
    found[PAGES] = [sum(len(page.splitlines()) for page in pages)]
    found[WORDS] = [sum(len(text.read_text("utf-8").split()) for text in texts)]
    return found


def lowered(budgets: dict[str, list[int]], found: dict[str, list[int]]) -> str:
    """Return budget.toml with no budget above what is there; where there is none, it is that."""
    lines = ["# [lines, lines of code] a folder may have; tests/house_rules/budget.py counts them."]
    for name, counts in found.items():
        least = [min(pair) for pair in zip(budgets.get(name, counts), counts, strict=True)]
        lines.append(f'"{name}" = {least}')
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None, root: Path = ROOT) -> int:
    """Print folder, lines, code and budget; 1 above a budget or where there is none."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--lower", action="store_true", help="lower the budgets to what is there")
    lower = parser.parse_args(arguments).lower
    file, found = root / "budget.toml", counted(root)
    budgets = tomllib.loads(file.read_text("utf-8")) if file.exists() else {}
    if lower:
        file.write_text(lowered(budgets, found), encoding="utf-8")
        budgets = tomllib.loads(file.read_text("utf-8"))
    rows, above = [f"{'folder':<42}{'lines':>7}{'code':>8}   budget"], 0
    for name, counts in found.items():
        budget = budgets.get(name, [0] * len(counts))
        over = any(count > most for count, most in zip(counts, budget, strict=True))
        above += over
        shown = "".join(f"{count:8d}" for count in counts)
        rows.append(
            f"{name:<41}{shown:<16}   {', '.join(map(str, budget))}{'   ABOVE' if over else ''}"
        )
    sys.stdout.write("\n".join(rows) + "\n")
    if above:
        sys.stderr.write(
            f"{above} above {file.name}: remove as much, or raise it there and name in the commit "
            "what pays for it\n"
        )
    return 1 if above else 0


if __name__ == "__main__":
    sys.exit(main())
