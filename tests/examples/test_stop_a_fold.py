"""A simulated robot that watches the live mesh stops where the cloth has slipped; only there."""

import pytest

pytest.importorskip("mujoco", reason="needs the extra lab")

from stop_a_fold import MOST_ERROR_M, fold


@pytest.mark.slow
def test_a_fold_is_stopped_where_the_cloth_has_slipped():
    slipped = fold("towel", 1, 0.4)
    assert slipped.reason
    assert 0.4 < slipped.way < 0.95  # after it slipped, and before the end


@pytest.mark.slow
def test_a_fold_that_goes_well_is_finished():
    done = fold("towel", 1, 1.0)
    assert done.reason == ""
    assert done.way > 0.99
    assert 0.0 < done.expected_error_m < MOST_ERROR_M
