"""Makes the writers of all formats importable, and a camera's film."""

import importlib.util
import sys
from pathlib import Path

import pytest

_spec = importlib.util.spec_from_file_location(
    "import_makers", Path(__file__).with_name("makers.py")
)
import_makers = importlib.util.module_from_spec(_spec)
sys.modules["import_makers"] = import_makers
_spec.loader.exec_module(import_makers)


@pytest.fixture
def film():
    """Four random pictures of depth and color."""
    return import_makers.Film()
