"""What the tests of this folder share: a stage to train, and pictures from above."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))

import line_stage


@pytest.fixture
def line():
    """A stage small enough to be trained a hundred times while the tests run."""
    return line_stage
