"""What the tests of this folder share: a stage to train, and pictures from above."""

import importlib.util
import sys
from pathlib import Path

import pytest


def _beside(name):
    """A module of this folder, which the tests here import by its name."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


line_stage = _beside("line_stage")
_beside("seen_above")


@pytest.fixture
def line():
    """A stage small enough to be trained a hundred times while the tests run."""
    return line_stage
