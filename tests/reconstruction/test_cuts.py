"""Cuts in any width and length: what is asked for, and nothing else changed."""

import numpy as np
import pytest

from clothtrack.reconstruction.cuts import cuts, finer

KINDS = ("towel", "tshirt", "trousers")


def longer_side(garment):
    return max(garment.size_m)


@pytest.mark.parametrize("kind", KINDS)
def test_a_search_begins_with_cuts_of_a_meter(kind):
    found = cuts(kind, 250)
    assert len({cut.cut for cut in found}) == len(found) >= 2
    for cut in found:
        assert longer_side(cut) == pytest.approx(1.0, rel=1e-6)
        assert abs(cut.mesh.vertex_count - 250) < 25


@pytest.mark.parametrize("kind", KINDS)
def test_a_resized_garment_has_the_size_and_the_cut(kind):
    for cut in cuts(kind, 250):
        other = cut.resized(0.44, 0.63)
        assert other.cut == cut.cut
        np.testing.assert_allclose(other.size_m, (0.44, 0.63), rtol=1e-9)
        np.testing.assert_array_equal(other.mesh.faces, cut.mesh.faces)
        scale = np.array([0.44, 0.63]) / cut.size_m
        np.testing.assert_allclose(
            other.mesh.vertices[:, :2], np.asarray(cut.mesh.vertices)[:, :2] * scale, rtol=1e-6
        )
        # What is stretched along both axes is larger by the mean of both in height.
        height, before = (np.ptp(one.mesh.canonical[:, 2]) for one in (other, cut))
        assert height == pytest.approx(before * np.sqrt(scale.prod()), rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_a_garment_resized_and_back_is_the_same(kind):
    cut = cuts(kind, 250)[0]
    back = cut.resized(0.3, 0.7).resized(*cut.size_m)
    np.testing.assert_allclose(back.mesh.canonical, cut.mesh.canonical, atol=1e-9)
    np.testing.assert_allclose(back.tokens.canonical, cut.tokens.canonical, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_tokens_of_a_larger_garment_are_the_larger_tokens(kind):
    cut = cuts(kind, 250)[-1]
    width, length = cut.size_m
    larger = cut.resized(1.5 * width, 1.5 * length)
    assert larger.tokens.size_m == pytest.approx(1.5)
    np.testing.assert_allclose(larger.tokens.canonical, 1.5 * cut.tokens.canonical, atol=1e-9)
    # All that the network is told are parts of the longer side, or of width and length.
    for name in ("features", "vertex_shares", "vertex_tokens", "blend", "mirror", "labelings"):
        ours, theirs = getattr(larger.tokens, name), getattr(cut.tokens, name)
        np.testing.assert_allclose(ours, theirs, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("kind", KINDS)
def test_a_finer_garment_has_its_size_and_more_vertices(kind):
    coarse = cuts(kind, 250)[-1].resized(0.4, 0.5)
    fine = finer(coarse, kind, 400)
    assert fine.cut == coarse.cut
    np.testing.assert_allclose(fine.size_m, coarse.size_m, rtol=1e-6)
    assert abs(fine.mesh.vertex_count - 400) < 40
