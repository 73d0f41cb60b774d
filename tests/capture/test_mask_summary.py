"""Masks are counted, and those that lose a piece from one frame to the next are named."""

import numpy as np

from clothtrack_capture.mask_pictures import MaskSummary, doubtful


def test_a_fold_that_halves_the_area_slowly_is_no_doubt():
    assert not doubtful(np.linspace(6000.0, 3000.0, 40)).any()


def test_a_piece_that_is_lost_and_a_gain_are_named():
    areas = np.full(30, 5000.0)
    areas[12], areas[20], areas[25] = 3000.0, 7000.0, 0.0
    assert np.flatnonzero(doubtful(areas)).tolist() == [12, 20, 25]


def test_a_single_frame_is_judged_too():
    assert not doubtful(np.array([100.0])).any()
    assert doubtful(np.array([0.0])).all()


def test_it_says_how_much_is_cloth_and_where_to_look():
    summary = MaskSummary(26, 4100, 0.14, 0.17, 20, tuple(range(10)))
    first, second = str(summary).splitlines()
    assert first == (
        "26 frames with cloth, 14.0 to 17.0 % of the picture (median 4100 pixels); smallest in "
        "frame 20"
    )
    assert second.startswith("look at frames 0, 1, 2, 3, 4, 5, 6, 7 and 2 more: ")
