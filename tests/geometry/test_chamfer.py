"""Chamfer distances against all pairs, and their laws."""

import numpy as np
import pytest

from clothtrack.errors import InvalidConfigError
from clothtrack.geometry.chamfer import one_way, two_way


def test_one_way_is_the_mean_over_all_pairs_minima():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(70, 3)), rng.normal(size=(50, 3))
    squares = ((a[:, None] - b[None]) ** 2).sum(-1)
    assert one_way(a, b) == pytest.approx(squares.min(1).mean(), rel=1e-12)
    assert two_way(a, b) == pytest.approx(squares.min(1).mean() + squares.min(0).mean(), rel=1e-12)


def test_an_empty_set_is_refused():
    with pytest.raises(InvalidConfigError, match="at least one"):
        one_way(np.zeros((0, 3)), np.zeros((4, 3)))
