"""Windows are found again: in other light, however fast they go, and not where they are not."""

import cv2
import numpy as np
import pytest

from clothtrack.recordings.optical_flow import carried, even_picture, matched, moved_with

HEIGHT, WIDTH = 120, 160
EVERYWHERE = np.ones((HEIGHT, WIDTH), bool)
ACROSS, DOWN = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
REPEAT_PX = 11.0


def weave(shift=(0.0, 0.0)):
    """Two waves that repeat every 11 pixels, moved by so many pixels."""
    waves = sum(
        np.cos((axis - moved) * 2.0 * np.pi / REPEAT_PX)
        for axis, moved in zip((ACROSS, DOWN), shift, strict=True)
    )
    return 120.0 + 20.0 * waves


def printed(seed=0):
    blots = np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH)).astype(np.float32)
    blots = cv2.GaussianBlur(blots, (0, 0), 2.0)
    return 120.0 + 40.0 * blots / blots.std()


def even(picture, cloth=EVERYWHERE):
    return even_picture(np.rint(np.clip(picture, 0, 255)).astype(np.uint8), cloth)


@pytest.fixture
def grid():
    """Middles of windows, away from the rim."""
    across, down = np.meshgrid(np.arange(30, 130, 10), np.arange(30, 90, 10))
    return np.stack([across.ravel(), down.ravel()], axis=1).astype(np.float32)


def test_an_even_picture_is_the_same_in_half_the_light():
    light = np.linspace(0.4, 1.0, WIDTH)
    inner = np.s_[10:-10, 10:-10]
    before, after = even(printed())[inner], even(printed() * light)[inner]
    apart = np.abs(before.astype(float) - after.astype(float))
    assert before.std() > 30.0
    assert apart.mean() < 0.1 * before.std()


def test_an_even_picture_is_of_the_cloth_alone():
    left = EVERYWHERE.copy()
    left[:, WIDTH // 2 :] = False
    table = np.where(left, printed(), 255.0)
    picture = even(table, left)
    assert (picture[~left] == 128).all()
    np.testing.assert_array_equal(picture, even(np.where(left, printed(), 0.0), left))
    assert (even(printed(), ~EVERYWHERE) == 128).all()


def test_a_weave_is_followed_farther_than_half_its_repeat_by_what_it_did_before(grid):
    step = np.array([8.0, -3.0], np.float32)
    steps = np.broadcast_to(step, grid.shape).copy()
    there, found = carried(even(weave()), even(weave(step)), grid, steps)
    assert found.all()
    assert np.abs(there - grid - step).max() < 0.1
    # Without it, the weave beside it looks the same.
    there, found = carried(even(weave()), even(weave(step)), grid, np.zeros_like(grid))
    assert np.linalg.norm(there - grid - step, axis=1)[found].min() > 0.9 * REPEAT_PX


def test_a_fast_print_is_found_where_those_beside_it_have_gone(grid):
    """A tenth of the points know how far they went; the others ask them, round by round."""
    shift = np.array([14.0, 9.0], np.float32)
    move = np.column_stack([np.eye(2), shift])
    after = cv2.warpAffine(printed(), move, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT)
    steps = np.zeros_like(grid)
    alone, found_alone = carried(even(printed()), even(after), grid, steps)
    assert not (found_alone & (np.linalg.norm(alone - grid - shift, axis=1) < 0.2)).any()
    steps[::10] = shift
    there, found = carried(even(printed()), even(after), grid, steps)
    right = np.linalg.norm(there - grid - shift, axis=1) < 0.2
    assert (found & right).mean() > 0.9
    assert not (found & ~right).any()


def test_what_is_not_there_is_not_found(grid):
    found = matched(even(printed()), even(printed(7)), grid, np.zeros_like(grid))[1]
    assert not found.any()


def test_nobody_and_nobody_near_tell_nothing():
    here, nobody = np.array([[50.0, 50.0]], np.float32), np.zeros((0, 2), np.float32)
    assert not moved_with(here, nobody, nobody)[1].any()
    far, near = here + 100.0, here + [[0.0, 20.0]]
    move = np.array([[3.0, 4.0]], np.float32)
    assert not moved_with(here, far, move)[1].any()
    moves, told = moved_with(here, near.astype(np.float32), move)
    assert told.all()
    np.testing.assert_array_equal(moves, move)


@pytest.mark.parametrize("away", [(-500.0, 0.0), (500.0, 0.0), (0.0, -500.0), (0.0, 500.0)])
def test_a_guess_far_outside_the_picture_is_not_found(away):
    picture, pixels = even(printed()), np.array([[80.0, 60.0]], np.float32)
    _, found = matched(picture, picture, pixels, np.array([away], np.float32))
    assert not found.any()
