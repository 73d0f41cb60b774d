"""What counts as code, and that a budget only falls, on a tree of three files."""

import tomllib

import budget
import pytest

MODULE = '''"""A docstring
of two lines."""

import os

# A remark.
NAMES = ("a",
         "b")
"""What they are."""


def one() -> int:
    """One."""
    return 1  # here
'''


@pytest.fixture
def tree(tmp_path):
    for name in ("src/cloth/room", "src/cloth/shipped", "tests", "docs"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "src/cloth/__init__.py").write_text("")
    (tmp_path / "src/cloth/room/module.py").write_text(MODULE)
    (tmp_path / "src/cloth/room/page.js").write_text("let a;\nlet b;\n")
    (tmp_path / "src/cloth/shipped/page.html").write_text("not\ncounted\n")
    (tmp_path / "README.md").write_text("two words\n")
    (tmp_path / "docs/page.md").write_text("and three more\n")
    return tmp_path


def test_above_a_budget_fails_and_below_it_only_lower_changes_it(tree, capsys):
    found = budget.counted(tree)
    assert found["src/cloth/room"] == found["src"] == [14, 4]
    assert (found[budget.PAGES], found[budget.WORDS]) == ([2], [5])
    assert budget.main([], tree) == 1
    assert budget.main(["--lower"], tree) == 0
    module = tree / "src/cloth/room/module.py"
    module.write_text(MODULE + "TWO = 2\n")
    assert budget.main(["--lower"], tree) == 1, "a budget was raised"
    assert "ABOVE" in capsys.readouterr().out
    module.write_text("ONE = 1\n")
    assert budget.main(["--lower"], tree) == 0
    kept = tomllib.loads((tree / "budget.toml").read_text())
    assert kept["src/cloth/room"] == [1, 1]
    module.write_text(MODULE)
    assert budget.main([], tree) == 1
