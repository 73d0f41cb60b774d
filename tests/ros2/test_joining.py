"""Depth, color, pose and grip of one moment, put together without DDS."""

import numpy as np
import pytest

from clothtrack.errors import InvalidRecordingError
from clothtrack_capture.ros2.joining import GripTrack, PictureQueue, Received, TipTrack

MS = 10**6
HOLD_S = 0.05


def picture(stamp_ms, came_s=0.0):
    return Received(stamp_ms * MS, stamp_ms * MS, came_s, str(stamp_ms).encode())


def queue(*, with_color=True):
    return PictureQueue("/depth", with_color=with_color, tolerance_s=0.016, hold_s=HOLD_S)


def given(pair):
    return None if pair is None else tuple(one and one.stamp_ns // MS for one in pair)


def test_the_newest_whole_pair_comes_first_and_what_is_older_never():
    pictures = queue()
    for stamp in (0, 33, 66, 100):
        pictures.add_depth(picture(stamp))
        pictures.add_color(picture(stamp + 1))
    pictures.add_depth(picture(133))
    assert given(pictures.next(0.0, None)) == (100, 101)
    assert pictures.counts.late == 3
    assert pictures.next(0.0, None) is None
    pictures.add_color(picture(134))
    assert given(pictures.next(0.0, None)) == (133, 134)
    assert pictures.counts.late == 3
    pictures.add_depth(picture(66))
    assert not pictures.waits


def test_a_nearer_color_picture_is_waited_for_but_not_for_ever():
    pictures = queue()
    pictures.add_color(picture(90))
    pictures.add_depth(picture(100))
    assert pictures.next(0.0, None) is None
    assert given(pictures.next(HOLD_S, None)) == (100, 90)
    pictures.add_depth(picture(200, came_s=1.0))
    pictures.add_color(picture(190))
    assert pictures.next(1.0, None) is None
    pictures.add_color(picture(205))
    assert given(pictures.next(1.0, None)) == (200, 205)


def test_depth_without_color_is_counted_and_does_not_stop_what_follows():
    pictures = queue()
    pictures.add_depth(picture(100))
    pictures.add_color(picture(60))
    assert pictures.next(HOLD_S, None) is None
    assert pictures.counts.alone == 1
    pictures.add_depth(picture(133))
    pictures.add_color(picture(133))
    assert given(pictures.next(0.0, None)) == (133, 133)


def test_a_picture_waits_for_the_pose_at_its_time():
    pictures = queue(with_color=False)
    pictures.add_depth(picture(100))
    pictures.add_depth(picture(133))
    assert pictures.next(0.0, 99 * MS) is None
    assert given(pictures.next(0.0, 120 * MS)) == (100, None)
    assert pictures.next(0.0, 120 * MS) is None
    assert given(pictures.next(HOLD_S, 120 * MS)) == (133, None)
    assert pictures.counts.late == 0


def test_the_queue_is_bounded():
    pictures = queue()
    for stamp in range(0, 3300, 33):
        pictures.add_depth(picture(stamp))
    assert pictures.counts.late == 92
    pictures.add_color(picture(3267))
    assert given(pictures.next(0.0, None)) == (3267, 3267)
    assert pictures.counts.late == 99


def test_a_clock_that_was_set_back_is_an_error():
    pictures = queue()
    pictures.add_depth(picture(5000))
    with pytest.raises(InvalidRecordingError, match=r"/depth: time went back by 4\.9 s"):
        pictures.add_depth(picture(100))


def test_a_tip_is_where_it_was_told_and_between_on_the_straight_line():
    tip = TipTrack()
    assert tip.known_ns == -1
    assert tip.at(0, 10**9) is None
    places = np.array([[0.1, 0.2, 0.3], [0.3, 0.2, 0.1]]) / 3
    tip.add(100 * MS, places[0])
    tip.add(140 * MS, places[1])
    tip.add(140 * MS, places[0])
    for stamp, place in zip((100, 140), places, strict=True):
        np.testing.assert_array_equal(tip.at(stamp * MS, 0), place)
    np.testing.assert_allclose(tip.at(110 * MS, 200 * MS), 0.75 * places[0] + 0.25 * places[1])
    assert tip.at(120 * MS, 10 * MS) is None
    np.testing.assert_array_equal(tip.at(300 * MS, 200 * MS), places[1])
    assert tip.at(400 * MS, 200 * MS) is None
    np.testing.assert_array_equal(tip.at(0, 200 * MS), places[0])
    assert tip.at(0, 99 * MS) is None


def test_a_grip_counts_by_the_clock_of_the_pictures():
    grip = GripTrack()
    assert not grip.at(10**12, 10**12)
    grip.add(1000 * MS, True, stamped=False)
    grip.add(1500 * MS, False, stamped=False)
    # The same clock: the picture was taken at 990 ms, before the gripper closed, and sent later.
    assert [grip.at(stamp * MS, 1040 * MS) for stamp in (990, 1001)] == [False, True]
    assert not grip.at(1500 * MS, 1530 * MS)
    # A bag from 1970 that is played now: what was sent before the picture counts.
    sent = 10**10
    later = GripTrack()
    later.add(sent + 1000 * MS, True, stamped=False)
    assert [later.at(5 * MS, sent + offset * MS) for offset in (990, 1001)] == [False, True]
    stamped = GripTrack()
    stamped.add(1000 * MS, True, stamped=True)
    assert [stamped.at(stamp * MS, sent) for stamp in (990, 1001)] == [False, True]
