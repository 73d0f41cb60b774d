"""What every test can rely on: the same seeds, a quiet Warp, one thread."""

import os
import random

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pytest

from clothtrack.geometry.devices import quiet_warp

quiet_warp()


@pytest.fixture(autouse=True)
def _same_seeds():
    """Libraries that draw from the global generators draw the same numbers in every run."""
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002


@pytest.fixture
def rng():
    """A seeded generator of the test's own."""
    return np.random.default_rng(0)
