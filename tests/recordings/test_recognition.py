"""A print has key points that look like no other; a weave, as far as it goes, has none."""

import cv2
import numpy as np
import pytest

from clothtrack.recordings.recognition import LEAST_RECOGNIZED, KeyPoints, Recognizer

HEIGHT, WIDTH = 120, 160
EVERYWHERE = np.ones((HEIGHT, WIDTH), bool)


def printed(seed=0):
    blots = np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH)).astype(np.float32)
    blots = cv2.GaussianBlur(blots, (0, 0), 2.0)
    return np.clip(120.0 + 60.0 * blots / blots.std(), 0, 255).astype(np.uint8)


def flat(points):
    """Places on a table [m], 5 mm a pixel."""
    return np.column_stack([0.005 * points.pixels.astype(float), np.zeros(len(points))])


def remembering(seen):
    recognizer = Recognizer()
    recognizer.remember(np.arange(len(seen)), seen, flat(seen))
    return recognizer


@pytest.mark.parametrize("period_px", [9, 11, 13, 16])
def test_a_weave_has_no_key_points_of_its_own(period_px):
    across, down = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    waves = np.cos(across * 2 * np.pi / period_px) + np.cos(down * 2 * np.pi / period_px)
    weave = np.rint(120.0 + 20.0 * waves).astype(np.uint8)
    assert len(KeyPoints.of(weave, EVERYWHERE)) < 10
    assert len(KeyPoints.of(printed(), EVERYWHERE)) > 100


def test_key_points_are_of_the_marked_part_only():
    left = EVERYWHERE.copy()
    left[:, WIDTH // 2 :] = False
    pixels = KeyPoints.of(printed(), left).pixels
    assert len(pixels) > 30
    assert pixels[:, 0].max() < WIDTH // 2


def test_a_print_is_recognized_and_another_is_not():
    seen, other = KeyPoints.of(printed(), EVERYWHERE), KeyPoints.of(printed(7), EVERYWHERE)
    recognizer = remembering(seen)
    assert recognizer.sees_print
    np.testing.assert_array_equal(recognizer.recognized(seen, flat(seen)), np.arange(len(seen)))
    assert (recognizer.recognized(other, flat(other)) == -1).all()


def test_what_is_farther_apart_than_cloth_can_stretch_is_not_recognized():
    seen = KeyPoints.of(printed(), EVERYWHERE)
    recognizer, places = remembering(seen), flat(seen)
    places[7] += [0.0, 0.0, 1.0]
    numbers = recognizer.recognized(seen, places)
    assert numbers[7] == -1
    assert (numbers >= 0).sum() == len(seen) - 1
    assert (recognizer.recognized(seen, 2.0 * flat(seen)) == -1).all()


def test_the_oldest_number_is_kept():
    seen = KeyPoints.of(printed(), EVERYWHERE)
    recognizer = remembering(seen)
    recognizer.remember(1000 + np.arange(len(seen)), seen, flat(seen))
    assert recognizer.recognized(seen, flat(seen)).max() < 1000


def test_a_first_picture_without_a_print_settles_it():
    seen = KeyPoints.of(printed(), EVERYWHERE)
    few = np.arange(len(seen)) < LEAST_RECOGNIZED - 1
    recognizer = remembering(seen[few])
    recognizer.remember(np.arange(len(seen)), seen, flat(seen))
    assert not recognizer.sees_print


def test_a_picture_without_anything_has_no_key_points():
    plain = np.full((HEIGHT, WIDTH), 120, np.uint8)
    nothing = KeyPoints.of(plain, EVERYWHERE)
    assert len(nothing) == 0
    assert (
        len(remembering(KeyPoints.of(printed(), EVERYWHERE)).recognized(nothing, flat(nothing)))
        == 0
    )
