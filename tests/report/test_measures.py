from dataclasses import replace

import numpy as np
import pytest

from clothtrack.report.measures import chamfer_rms_mm, charts, edge_strains


def test_a_cloud_on_the_vertices_is_at_no_distance(tracked):
    clouds = [
        positions[seen].astype(float)
        for positions, seen in zip(tracked.positions, tracked.visible, strict=True)
    ]
    np.testing.assert_allclose(chamfer_rms_mm(tracked, clouds), 0.0, atol=1e-3)


def test_a_cloud_beside_the_cloth_is_as_far_as_it_was_moved(tracked):
    still = replace(tracked, positions=np.repeat(tracked.mesh.vertices[None], 6, axis=0),
                    visible=np.ones_like(tracked.visible))  # fmt: skip
    clouds = [tracked.mesh.vertices + np.array([0.0, 0.0, 0.003])] * 6
    np.testing.assert_allclose(chamfer_rms_mm(still, clouds), 3.0, rtol=1e-6)


def test_no_cloud_is_no_number(tracked):
    assert np.isnan(chamfer_rms_mm(tracked, [np.empty((0, 3))] * 6)).all()


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.2])
def test_strain_is_the_change_of_scale(tracked, scale):
    grown = replace(tracked, positions=np.repeat(scale * tracked.mesh.vertices[None], 6, axis=0))
    np.testing.assert_allclose(edge_strains(grown), abs(scale - 1), atol=1e-6)


def test_dropped_corrections_are_marked(tracked):
    search = next(c for c in charts(tracked, np.zeros(6)) if c.title == "Line search")
    assert search.marks == (3,)
