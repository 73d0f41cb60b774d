"""A coarse mesh is the same garment, made of points of the fine one."""

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.coverage import projected_area
from clothtrack.planning.coarse_cloth import CoarseConfig, Coarsener


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_a_coarse_garment_lies_in_the_fine_one(kind):
    fine = garment(kind, vertex_count=900, pattern="random", seed=3)
    coarsen = Coarsener(fine, kind, CoarseConfig(spacing_m=0.03))
    assert coarsen.flat.vertex_count < 400
    assert np.median(coarsen.flat.edge_lengths) == pytest.approx(0.03, rel=0.25)
    there = coarsen(fine.vertices)
    np.testing.assert_allclose(there[:, :2], coarsen.flat.vertices[:, :2], atol=2e-3)
    fine_area = projected_area(fine.vertices, fine.faces)
    assert projected_area(there, coarsen.flat.faces) == pytest.approx(fine_area, rel=0.03)


def test_coarse_vertices_follow_every_linear_motion_of_the_fine_cloth():
    fine = garment("tshirt", vertex_count=700)
    coarsen = Coarsener(fine, "tshirt")
    change = np.array([[0.5, 0.1, 0.0], [-0.2, 0.8, 0.3], [0.0, 0.4, 1.0]])
    here, there = coarsen(fine.vertices), coarsen(fine.vertices @ change.T + [1.0, 2.0, 3.0])
    np.testing.assert_allclose(there, here @ change.T + [1.0, 2.0, 3.0], atol=1e-9)


def test_the_two_layers_of_a_shirt_stay_apart():
    fine = garment("tshirt", vertex_count=900)
    coarsen = Coarsener(fine, "tshirt")
    raised = fine.vertices.copy()
    front = fine.canonical[:, 2] > 0.0
    raised[front, 2] += 0.1
    up = coarsen(raised)[:, 2] - coarsen(fine.vertices)[:, 2]
    deep = np.abs(coarsen.flat.canonical[:, 2]) > 0.03
    own_front = coarsen.flat.canonical[deep, 2] > 0.0
    assert (up[deep][own_front] > 0.07).all()
    assert (up[deep][~own_front] < 0.03).all()
