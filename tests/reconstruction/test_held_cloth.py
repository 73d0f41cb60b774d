"""Laws of where cloth that hangs in the air may lie."""

import numpy as np
import pytest
from jaxtyping import Float

from clothtrack.geometry.camera import Camera
from clothtrack.reconstruction.seen_cloth import SeenCloth

PIXELS, DISTANCE_M, FOCAL = 64, 1.0, 100.0


def seen_surface(height_m: Float[np.ndarray, "height width"]) -> SeenCloth:
    """Return what a camera 1 m over the table sees of cloth at heights [m]; 0 where none is."""
    center = 0.5 * (PIXELS - 1)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = DISTANCE_M
    camera = Camera("above", PIXELS, PIXELS, FOCAL, FOCAL, center, center, pose)
    seen = height_m > 0.0
    return SeenCloth(camera, np.where(seen, DISTANCE_M - height_m, 0.0), seen, 0.0)


def steep() -> SeenCloth:
    """Return a sheet that falls by 40 cm over 16 columns."""
    height_m = np.zeros((PIXELS, PIXELS))
    height_m[16:48, 24:40] = 0.5 - 0.4 * np.arange(16) / 15.0
    return seen_surface(height_m)


def test_a_vertex_beside_steep_cloth_goes_to_it_and_not_below_it() -> None:
    """Beside a steep sheet, the nearest allowed place is to the side."""
    cloth = steep()
    on = cloth.points[np.abs(cloth.points[:, 2] - 0.3).argmin()]
    vertices = (on + [0.004, 0.0, 0.004])[None]

    moved = cloth.confined(vertices)

    assert np.linalg.norm(moved - vertices) <= np.linalg.norm(on - vertices) + 1e-9
    assert moved[0, 2] > on[2] - 0.005


def test_a_jittered_steep_sheet_does_not_sink() -> None:
    """Small errors of both signs leave the mean height of a hanging sheet where it is."""
    cloth = steep()
    rng = np.random.default_rng(0)
    vertices = cloth.points + rng.normal(0.0, 0.004, cloth.points.shape)

    for _ in range(10):
        vertices = cloth.confined(vertices + rng.normal(0.0, 0.004, vertices.shape))

    assert vertices[:, 2].mean() == pytest.approx(cloth.points[:, 2].mean(), abs=0.02)


def test_a_vertex_over_flat_cloth_goes_straight_down() -> None:
    """Over cloth that lies, the nearest allowed place is below."""
    cloth = seen_surface(np.pad(np.full((32, 32), 0.01), 16))
    vertices = np.array([[0.013, -0.021, 0.016]])

    np.testing.assert_allclose(cloth.confined(vertices), [[0.013, -0.021, 0.01]], atol=1e-6)


def test_one_measured_pixel_is_a_point() -> None:
    """A cloth so narrow that no pixel of the quarter shows it still has a point."""
    height_m = np.zeros((PIXELS, PIXELS))
    height_m[31, 31] = 0.2

    assert len(seen_surface(height_m).points) == 1
