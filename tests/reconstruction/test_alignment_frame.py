import numpy as np
import pytest

from clothtrack.garments.garment_meshes import garment
from clothtrack.reconstruction.alignment_frame import TURNED_OVER, align


def turn(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


@pytest.mark.parametrize("side", [np.eye(3), TURNED_OVER], ids=["on its back", "on its face"])
@pytest.mark.parametrize("degrees", [0.0, 35.0, 170.0, -100.0])
def test_a_known_turn_is_found(degrees, side, rng):
    canonical = garment("tshirt", vertex_count=500).canonical
    shift = np.array([0.3, -0.1, 0.02])
    world = canonical @ (turn(degrees) @ side).T + shift
    found = align(world, canonical, rng.random(len(world)))
    np.testing.assert_allclose(found.to_canonical(world), canonical, atol=1e-9)
    np.testing.assert_allclose(found.rotation @ turn(degrees) @ side, np.eye(3), atol=1e-9)


def test_there_and_back(rng):
    points = rng.normal(size=(20, 3))
    found = align(points, rng.normal(size=(20, 3)), np.ones(20))
    np.testing.assert_allclose(found.to_world(found.to_canonical(points)), points, atol=1e-12)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_no_other_turn_is_better(rng):
    canonical = garment("towel", vertex_count=300).canonical
    world = canonical @ turn(40.0).T + 0.02 * rng.normal(size=canonical.shape)
    weights = rng.random(len(world))

    def remainder(rotation):
        centerd = (world - weights @ world / weights.sum()) @ rotation.T
        target = canonical - weights @ canonical / weights.sum()
        return weights @ ((centerd - target) ** 2).sum(axis=1)

    best = remainder(align(world, canonical, weights).rotation)
    for degrees in np.linspace(0, 360, 73):
        for side in (np.eye(3), TURNED_OVER):
            assert best <= remainder(turn(degrees) @ side) + 1e-12


def test_points_without_confidence_do_not_count(rng):
    canonical = garment("tshirt", vertex_count=500).canonical
    world = canonical @ turn(60.0).T
    wrong = np.arange(len(world)) % 3 == 0
    world[wrong] = rng.normal(size=(int(wrong.sum()), 3))
    found = align(world, canonical, (~wrong).astype(float))
    np.testing.assert_allclose(found.to_canonical(world)[~wrong], canonical[~wrong], atol=1e-9)


def test_without_any_confidence_all_points_count(rng):
    canonical = garment("towel", vertex_count=300).canonical
    world = canonical @ turn(25.0).T
    found = align(world, canonical, np.zeros(len(world)))
    np.testing.assert_allclose(found.to_canonical(world), canonical, atol=1e-9)
