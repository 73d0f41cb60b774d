"""surface.txt is what the package shows today, so that every change of it is seen in review."""

import subprocess
import sys
from pathlib import Path

import surface


def test_the_surface_is_the_one_that_was_reviewed(tmp_path):
    # In a process of its own, because the checks of shapes change signatures here.
    made = tmp_path / "surface.txt"
    subprocess.run([sys.executable, Path(surface.__file__), made], check=True)
    assert made.read_text("utf-8") == surface.FILE.read_text("utf-8"), (
        "run python tests/house_rules/surface.py and say in CHANGELOG.md what changed"
    )
