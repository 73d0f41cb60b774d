import numpy as np

from clothtrack.simulation.picker import grasp_vertices

LINE = np.array([[0.0, 0, 0], [0.01, 0, 0], [0.02, 0, 0], [0.03, 0, 0]])


def test_nearest_vertices_come_first_and_no_more_than_asked():
    held = grasp_vertices(LINE, np.array([0.019, 0, 0]), radius=0.1, count=3)
    np.testing.assert_array_equal(held, [2, 1, 3])


def test_cloth_out_of_reach_is_not_held():
    assert len(grasp_vertices(LINE, np.array([0.0, 0.0, 0.05]), radius=0.02)) == 0
