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
    """From the points with confidence alone."""
    canonical = garment("tshirt", vertex_count=500).canonical
    world = canonical @ (turn(degrees) @ side).T + np.array([0.3, -0.1, 0.02])
    wrong = np.arange(len(world)) % 3 == 0
    given = np.where(wrong[:, None], rng.normal(size=world.shape), world)
    found = align(given, canonical, np.where(wrong, 0.0, rng.random(len(world))))
    np.testing.assert_allclose(found.to_canonical(world), canonical, atol=1e-9)
    np.testing.assert_allclose(found.to_world(canonical), world, atol=1e-9)
    np.testing.assert_allclose(found.rotation @ turn(degrees) @ side, np.eye(3), atol=1e-9)
