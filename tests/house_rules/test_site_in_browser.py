"""The documentation as a person opens it: from disk, in a browser without network."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_spec = importlib.util.spec_from_file_location(
    "chromium", ROOT / "tests" / "report" / "chromium.py"
)
chromium = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(chromium)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium.find_chromium() is None, reason="no Chromium on this machine"),
]


@pytest.mark.parametrize("opened_page", ["cli.html", "notebook/index.html"])
def test_the_search_finds_a_page_from_disk(tmp_path, opened_page):
    site = tmp_path / "site"
    subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", site],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        check=True,
    )
    with chromium.opened(
        chromium.find_chromium(), site / opened_page, tmp_path / "profile"
    ) as page:
        x, y, width, height = page.ask(
            "(() => { const b = document.querySelector('.md-search__input')"
            ".getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; })()"
        )
        at = {"x": x + width / 2, "y": y + height / 2, "button": "left", "clickCount": 1}
        page.call("Input.dispatchMouseEvent", type="mousePressed", **at)
        page.call("Input.dispatchMouseEvent", type="mouseReleased", **at)
        page.call("Input.insertText", text="optical axis kilograms")
        page.wait_for("document.querySelector('.md-search-result__link') !== null")
        found = page.ask("document.querySelector('.md-search-result__link').pathname")
        assert found == f"{site}/conventions.html"
        assert page.complaints() == []
        assert [url for url in page.requests() if not url.startswith(("file:", "data:"))] == []
