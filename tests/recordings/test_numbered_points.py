"""Points keep their numbers in order, and know who ran away from them."""

import numpy as np

from clothtrack.recordings.numbered_points import NEIGHBORS, NOBODY, NumberedPoints


def row_of(count):
    """Points a centimeter apart in a row, and where they are [m]."""
    pixels = np.column_stack([10.0 * np.arange(count), np.zeros(count)]).astype(np.float32)
    positions = np.column_stack([0.001 * pixels, np.zeros(count)]).astype(float)
    points = NumberedPoints.fresh(np.arange(count), pixels)
    return points.with_neighbors(positions), positions


def test_points_stay_in_the_order_of_their_numbers():
    pixels = np.arange(6, dtype=np.float32).reshape(3, 2)
    points = NumberedPoints.fresh(np.array([7, 2, 5]), pixels)
    np.testing.assert_array_equal(points.numbers, [2, 5, 7])
    np.testing.assert_array_equal(points.pixels, pixels[[1, 2, 0]])
    both = points.together_with(NumberedPoints.fresh(np.array([3]), pixels[:1]))
    np.testing.assert_array_equal(both.numbers, [2, 3, 5, 7])
    np.testing.assert_array_equal(both.are_in(points), [True, False, True, True])
    assert len(NumberedPoints.none().together_with(points)) == 3


def test_steps_are_from_the_picture_before():
    points, _ = row_of(4)
    moved = points.at(points.pixels + np.float32(2.0))
    np.testing.assert_array_equal(moved.steps, np.full((4, 2), 2.0))


def test_who_runs_away_from_most_is_not_near_them():
    points, positions = row_of(30)
    assert points.near_each_other(positions).all()
    positions[11] += [0.0, 0.0, 0.2]
    np.testing.assert_array_equal(np.flatnonzero(~points.near_each_other(positions)), [11])


def test_those_that_are_lost_have_no_say():
    points, positions = row_of(30)
    left = np.arange(30) % 2 == 0
    positions[left] += [0.5, 0.0, 0.0]
    assert points[left].near_each_other(positions[left]).all()
    assert not NumberedPoints.none().near_each_other(np.zeros((0, 3))).any()


def test_fewer_points_than_neighbors_have_nobody_beside_them():
    points, positions = row_of(3)
    assert points.beside.shape == (3, NEIGHBORS)
    assert (points.beside[:, 2:] == NOBODY).all()
    assert points.near_each_other(positions).all()
    nobody = NumberedPoints.none()
    assert len(nobody.with_neighbors(np.zeros((0, 3)))) == 0
