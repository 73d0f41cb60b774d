import numpy as np

from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.simulation.constraints import bend_constraints, stretch_constraints


def test_no_two_pairs_of_one_color_share_a_vertex():
    mesh = towel(0.08, 0.06, 0.01)
    for constraints in (stretch_constraints(mesh), bend_constraints(mesh)):
        for first, count in constraints.colors:
            vertices = constraints.pairs[first : first + count].ravel()
            assert len(np.unique(vertices)) == len(vertices)


def test_every_edge_is_kept_once_with_its_length():
    mesh = towel(0.05, 0.04, 0.01)
    constraints = stretch_constraints(mesh)
    order = np.lexsort((constraints.pairs[:, 1], constraints.pairs[:, 0]))
    np.testing.assert_array_equal(constraints.pairs[order], mesh.edges)
    np.testing.assert_allclose(constraints.lengths[order], mesh.edge_lengths, rtol=1e-6)


def test_bend_pairs_face_each_other_across_an_edge():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    mesh = ClothMesh(square, np.array([[0, 1, 2], [0, 2, 3]]))
    np.testing.assert_array_equal(bend_constraints(mesh).pairs, [[1, 3]])
