"""A fit keeps lengths and layers: a cloth folded in half, by true and by blurred answers."""

import numpy as np
import pytest
import seen_above as above

from clothtrack.garments.garment_meshes import towel
from clothtrack.geometry.quality import crossings
from clothtrack.reconstruction.isometric_fit import GAP_M, Guide, IsometricFit
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.reconstruction.token_meshes import finished

SIZE_M = (0.4, 0.3)


@pytest.fixture(scope="module")
def flat():
    return towel(*SIZE_M, 0.0125)


@pytest.fixture(scope="module")
def fit(flat):
    return IsometricFit(flat)


@pytest.fixture(scope="module")
def truth(flat):
    return above.half_folded(flat, at_m=0.0)


@pytest.fixture(scope="module")
def cloth(flat, truth):
    return above.seen_from_above(truth, flat.faces)


@pytest.fixture(scope="module")
def guide(flat, truth, cloth, fit):
    """True correspondences of what is seen; places drawn towards their mean, as a network's are."""
    upper = flat.canonical[:, 0] > 0.0
    seen = SeenPoints(truth[upper], np.asarray(flat.canonical)[upper], np.ones(upper.sum()))
    blurred = truth.copy()
    blurred[:, :2] *= 0.8
    blurred += np.random.default_rng(0).normal(0.0, (0.003, 0.003, 0.001), truth.shape)
    return Guide(seen, blurred, np.full(len(truth), 0.02), max(SIZE_M))


@pytest.fixture(scope="module")
def laid(fit, guide, cloth):
    return fit.lay(guide, cloth)


def strain(flat, vertices):
    ends = vertices[flat.edges]
    return np.abs(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / flat.edge_lengths - 1.0)


def test_a_cloth_folded_in_half_comes_out_as_two_flat_layers(flat, guide, cloth, laid, truth):
    """Though the blurred places are short by a fifth and off by centimeters."""
    assert strain(flat, guide.places).mean() > 0.15
    assert strain(flat, laid).mean() < 0.01
    x = flat.canonical[:, 0]
    layers = [laid[x < -0.03], laid[x > 0.03]]
    for layer in layers:
        assert layer[:, 2].std() < GAP_M
    assert layers[1][:, 2].mean() - layers[0][:, 2].mean() > 0.5 * GAP_M
    assert np.linalg.norm(laid - truth, axis=1).mean() < 0.004
    assert crossings(laid, flat.faces) <= 2
    np.testing.assert_allclose(cloth.confined(laid)[:, :2], laid[:, :2], atol=0.004)


def test_layers_are_taken_apart_by_their_heights_alone(flat, fit, truth, rng):
    pressed = truth * (1.0, 1.0, 0.0) + (0.0, 0.0, 0.001)
    apart = fit.layered(pressed, truth[:, 2], 0.0)
    np.testing.assert_array_equal(apart[:, :2], pressed[:, :2])
    x = flat.canonical[:, 0]
    assert apart[x > 0.03, 2].min() - apart[x < -0.03, 2].max() > 0.7 * GAP_M
    assert apart[:, 2].min() >= 0.0
    # The other order, if that is what is said.
    under = fit.layered(pressed, -truth[:, 2], 0.0)
    assert under[x < -0.03, 2].min() - under[x > 0.03, 2].max() > 0.7 * GAP_M


def test_the_opposite_order_lays_the_same_fold_below(flat, fit, guide, cloth):
    over, under = (
        finished(fit, guide, cloth, table=None, opposite=opposite).positions
        for opposite in (False, True)
    )
    x = flat.canonical[:, 0]
    folded, lying = x > 0.03, x < -0.03
    assert over[folded, 2].mean() > over[lying, 2].mean() + 0.5 * GAP_M
    assert under[folded, 2].mean() < under[lying, 2].mean() - 0.5 * GAP_M
    assert np.linalg.norm((over - under)[:, :2], axis=1).mean() < 0.01
