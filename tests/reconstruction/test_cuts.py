"""Cuts in any width and length: what is asked for, and nothing else changed."""

import numpy as np
import pytest

from clothtrack.reconstruction.cuts import cuts, finer

KINDS = ("towel", "tshirt", "trousers")


@pytest.mark.parametrize("kind", KINDS)
def test_a_resized_garment_has_the_size_and_the_cut(kind):
    found = cuts(kind, 250)
    assert len({cut.cut for cut in found}) == len(found) >= 2
    for cut in found:
        assert max(cut.size_m) == pytest.approx(1.0, rel=1e-6)
        assert abs(cut.mesh.vertex_count - 250) < 25
        other = cut.resized(0.44, 0.63)
        assert other.cut == cut.cut
        np.testing.assert_allclose(other.size_m, (0.44, 0.63), rtol=1e-9)
        np.testing.assert_array_equal(other.mesh.faces, cut.mesh.faces)
        # What is stretched along both axes is larger by the mean of both in height.
        width, length = np.array([0.44, 0.63]) / cut.size_m
        scaled = cut.mesh.canonical * (width, length, np.sqrt(width * length))
        np.testing.assert_allclose(other.mesh.canonical, scaled, atol=1e-6)
        back = other.resized(*cut.size_m)
        np.testing.assert_allclose(back.tokens.canonical, cut.tokens.canonical, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_finer_garment_has_its_size_and_more_vertices(kind):
    coarse = cuts(kind, 250)[-1].resized(0.4, 0.5)
    fine = finer(coarse, kind, 400)
    assert fine.cut == coarse.cut
    np.testing.assert_allclose(fine.size_m, coarse.size_m, rtol=1e-6)
    assert abs(fine.mesh.vertex_count - 400) < 40
