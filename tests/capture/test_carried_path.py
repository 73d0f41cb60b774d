"""The arc of a hand: its ends, its height, and what the cloth says of them."""

from dataclasses import replace

import numpy as np
import pytest

from clothtrack_capture.carried_path import (
    UNDER_TIP_M,
    CarriedPath,
    HighestCloth,
    fitted_path,
    highest_cloth,
)

UP = np.array([0.0, 0.0, 1.0])
PATH = CarriedPath(
    np.array([0.10, 0.05, 0.004]), np.array([-0.05, 0.08, 0.010]), UP, 1.0, 2.2, 0.09, 4
)
TIMES = np.arange(0.0, 4.0, 0.05)


def seen_of(path, *, resting=(0.004, 0.012), noise_m=0.0, seed=0):
    """The highest cloth while a hand goes along a path: a little under the tip."""
    rng = np.random.default_rng(seed)
    positions = path.positions_at(TIMES)
    before = np.where(0.5 * (path.start_s + path.end_s) > TIMES, *resting)
    lifted = positions[:, 2] - UNDER_TIP_M
    along = np.linalg.norm((positions - path.pick)[:, :2], axis=1)
    height = np.maximum(before, lifted) + rng.normal(0.0, noise_m, len(TIMES))
    return HighestCloth(TIMES, height, along + rng.normal(0.0, noise_m, len(TIMES)))


def fit(clicked, seen, between=(0.0, 4.0)):
    return fitted_path(clicked, seen, (clicked.pick[2], clicked.place[2]), between)


@pytest.mark.parametrize("steepness", [2, 4, 6])
def test_a_path_rests_at_both_ends_and_rises_by_its_lift_over_the_middle(steepness):
    path = replace(PATH, steepness=steepness)
    at = path.positions_at(np.array([0.0, 1.0, 1.6, 2.2, 3.0]))
    np.testing.assert_allclose(at[:2], [path.pick] * 2, atol=1e-12)
    np.testing.assert_allclose(at[3:], [path.place] * 2, atol=1e-12)
    np.testing.assert_allclose(at[2], 0.5 * (path.pick + path.place) + 0.09 * UP, atol=1e-12)
    whole = path.positions_at(TIMES)
    along = (whole - path.pick) @ (path.place - path.pick)
    assert (np.diff(along) > -1e-12).all()


@pytest.mark.parametrize("steepness", [2, 4, 6])
@pytest.mark.parametrize("off_s", [(0.15, 0.15), (-0.15, -0.15), (0.15, -0.15), (-0.3, 0.3)])
def test_wrong_frames_are_corrected_by_the_cloth(steepness, off_s):
    true = replace(PATH, steepness=steepness)
    clicked = CarriedPath(true.pick, true.place, UP, true.start_s + off_s[0], true.end_s + off_s[1])
    found = fit(clicked, seen_of(true, noise_m=0.001))
    assert found is not None
    off_m = np.linalg.norm(found.positions_at(TIMES) - true.positions_at(TIMES), axis=1)
    clicked_off_m = np.linalg.norm(clicked.positions_at(TIMES) - true.positions_at(TIMES), axis=1)
    assert off_m.max() < 0.012
    assert off_m.max() < 0.4 * clicked_off_m.max()
    assert abs(found.lift_m - true.lift_m) < 0.0101


def test_cloth_that_never_rises_says_nothing():
    flat = HighestCloth(TIMES, np.full(len(TIMES), 0.004), np.zeros(len(TIMES)))
    assert fit(PATH, flat) is None
    hidden = HighestCloth(TIMES, np.full(len(TIMES), np.nan), np.full(len(TIMES), np.nan))
    assert fit(PATH, hidden) is None


def test_start_and_end_stay_between_the_neighboring_actions_and_hidden_frames_do_not_count():
    seen = seen_of(PATH)
    seen.height_m[::3] = seen.along_m[::3] = np.nan
    found = fit(replace(PATH, start_s=1.15, end_s=2.05), seen, (1.02, 2.18))
    assert found is not None
    assert 1.02 <= found.start_s < 1.06
    assert 2.14 < found.end_s <= 2.18


def test_the_highest_cloth_is_the_same_from_every_side():
    rng = np.random.default_rng(0)
    pick, place = np.array([0.0, 0.0, 0.0]), np.array([0.2, 0.0, 0.0])
    points = rng.uniform((-0.3, -0.3, 0.0), (0.3, 0.3, 0.01), (400_000, 3))
    bump = np.linalg.norm(points[:, :2] - (0.12, 0.02), axis=1) < 0.01
    points[bump, 2] += 0.06
    # Higher cloth beside the corridor is not what is held.
    points[np.abs(points[:, 1]) > 0.1, 2] += 0.2
    height, along = highest_cloth(points, points[:, 2], pick, place, UP)
    assert height == pytest.approx(0.0695, abs=0.0005)
    assert along == pytest.approx(0.12, abs=0.01)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    turned = highest_cloth(points @ turn.T, points[:, 2], turn @ pick, turn @ place, turn @ UP)
    np.testing.assert_allclose(turned, (height, along), atol=1e-9)


def test_cloth_laid_down_where_it_was_taken_has_a_path_too():
    home = replace(PATH, place=PATH.pick)
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (100, 3)) + home.pick
    assert np.isfinite(highest_cloth(points, points[:, 2], home.pick, home.place, UP)).all()
    found = fit(replace(home, start_s=1.1, end_s=2.1), seen_of(home))
    assert found is not None
    assert np.linalg.norm(found.positions_at(TIMES) - home.positions_at(TIMES), axis=1).max() < 0.02
