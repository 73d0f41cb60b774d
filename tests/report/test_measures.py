from dataclasses import replace

import numpy as np
import pytest

from clothtrack.report.sections import charts, edge_strains


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.2])
def test_strain_is_the_change_of_scale(tracked, scale):
    grown = replace(tracked, positions=np.repeat(scale * tracked.mesh.vertices[None], 6, axis=0))
    np.testing.assert_allclose(edge_strains(grown), abs(scale - 1), atol=1e-6)


def test_dropped_corrections_are_marked(tracked):
    search = next(c for c in charts(tracked, np.zeros(6), np.zeros(6)) if c.title == "Line search")
    assert search.marks == (3,)
