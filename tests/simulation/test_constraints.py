import numpy as np

from clothtrack.simulation.constraints import bend_constraints, stretch_constraints
from simulation.cloths import sheet


def test_no_two_pairs_of_one_colour_share_a_vertex():
    mesh = sheet(9, 7, 0.01)
    for constraints in (stretch_constraints(mesh), bend_constraints(mesh)):
        for first, count in constraints.colours:
            vertices = constraints.pairs[first : first + count].ravel()
            assert len(np.unique(vertices)) == len(vertices)


def test_every_edge_is_kept_once_with_its_length():
    mesh = sheet(5, 4, 0.01)
    constraints = stretch_constraints(mesh)
    order = np.lexsort((constraints.pairs[:, 1], constraints.pairs[:, 0]))
    np.testing.assert_array_equal(constraints.pairs[order], mesh.edges)
    np.testing.assert_allclose(constraints.lengths[order], mesh.edge_lengths, rtol=1e-6)


def test_bend_pairs_face_each_other_across_an_edge():
    mesh = sheet(2, 2, 0.01)
    np.testing.assert_array_equal(bend_constraints(mesh).pairs, [[1, 2]])
