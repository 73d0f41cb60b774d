"""docs/api.md is what `docs/make_api.py` makes of today's docstrings."""

import subprocess
import sys
from pathlib import Path

import clothtrack as ct

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_of_the_interface_is_not_stale(tmp_path):
    made = tmp_path / "api.md"
    subprocess.run([sys.executable, DOCS / "make_api.py", made], check=True)
    assert (DOCS / "api.md").read_text("utf-8") == made.read_text("utf-8"), (
        "docs/api.md is older than the docstrings; run: python docs/make_api.py"
    )


def test_the_page_of_the_interface_has_every_name():
    page = (DOCS / "api.md").read_text("utf-8")
    missing = [name for name in ct.__all__ if f"### {name}\n" not in page]
    assert missing == ["__version__"]
