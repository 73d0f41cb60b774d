"""Where a picture lets a cloth lie: confined points, gaps, what is hidden, sizes."""

from dataclasses import replace

import numpy as np
import pytest
import seen_above as above

from clothtrack.garments.garment_meshes import towel
from clothtrack.reconstruction.data.view import crop
from clothtrack.reconstruction.seen_cloth import CLOSED_PIXELS, SeenCloth
from clothtrack.reconstruction.tokens.token_network import TokenNetworkConfig

TOP_M = 0.01


@pytest.fixture(scope="module")
def flat():
    return towel(0.3, 0.2, 0.02)


@pytest.fixture(scope="module")
def cloth(flat):
    """A flat rectangle a centimeter over the table."""
    return above.seen_from_above(flat.vertices + (0.02, -0.03, TOP_M), flat.faces)


@pytest.fixture(scope="module")
def points():
    rng = np.random.default_rng(0)
    return np.column_stack([rng.uniform(-0.24, 0.24, (400, 2)), rng.uniform(0.0, TOP_M, 400)])


def pixels_of(cloth, points):
    pixels, _ = cloth.camera.project(points)
    return np.rint(pixels).astype(int)


def free_at(cloth, points):
    column, row = pixels_of(cloth, points).T
    return cloth.free[row, column]


def test_points_inside_stay_and_points_outside_come_to_the_nearest_free_pixel(cloth, points):
    confined = cloth.confined(points)
    inside = free_at(cloth, points)
    assert 50 < inside.sum() < 350
    np.testing.assert_array_equal(confined[inside], points[inside])
    rows, columns = np.nonzero(cloth.free)
    for before, after in zip(points[~inside], confined[~inside], strict=True):
        column, row = pixels_of(cloth, before[None])[0]
        to_column, to_row = pixels_of(cloth, after[None])[0]
        assert cloth.free[to_row, to_column]
        nearest = np.hypot(rows - row, columns - column).min()
        assert np.hypot(to_row - row, to_column - column) == pytest.approx(nearest)
        assert after[2] == before[2]


@pytest.fixture(scope="module")
def picture(flat):
    return above.picture_of(flat.vertices + (0.0, 0.0, 0.003), flat.faces)


def seen(picture):
    view = crop(picture.depth_m, picture.mask, picture.camera, TokenNetworkConfig())
    return SeenCloth.of(view, picture, 0.0)


def test_a_gap_as_wide_as_noise_is_free_and_a_wider_one_is_not(picture):
    whole = seen(picture)
    pixel_m = 1.0 / whole.camera.fx * whole.camera.position[2]
    for pixels, closed in [(2 * CLOSED_PIXELS - 1, True), (2 * CLOSED_PIXELS + 5, False)]:
        half = round(0.5 * pixels * pixel_m / (0.7 / 400))
        mask = picture.mask.copy()
        mask[:, 200 - half : 200 + half] = False
        cloth = seen(replace(picture, mask=mask))
        middle = cloth.camera.width // 2
        row = np.flatnonzero(cloth.seen.any(axis=1))[10]
        assert not cloth.seen[row, middle]
        assert cloth.free[row, middle] == closed


def test_behind_a_tool_and_beyond_the_picture_cloth_may_lie(picture):
    mask, depth = picture.mask.copy(), picture.depth_m.copy()
    depth[100:180, 230:260], mask[100:180, 230:260] = 0.9, False
    cloth = seen(replace(picture, mask=mask, depth_m=depth))
    at = np.array([[(245 - 199.5) * 0.7 / 400, (199.5 - 140) * 0.7 / 400, 0.0]])
    assert free_at(cloth, at).all()
    # The same patch without anything that stands there is a hole in the cloth.
    bare = seen(replace(picture, mask=mask))
    assert not free_at(bare, at).any()
    cut = slice(0, 200)
    camera = replace(picture.camera, width=200)
    half = replace(picture, mask=mask[:, cut], depth_m=depth[:, cut], camera=camera)
    right = np.array([[0.01, 0.0, 0.0]])
    assert free_at(seen(half), right).all()


@pytest.fixture
def steep():
    """A sheet that falls by 40 cm over 16 columns, seen from 1 m over the table."""
    height_m = np.zeros((64, 64))
    height_m[16:48, 24:40] = 0.5 - 0.4 * np.arange(16) / 15.0
    camera = above.camera_above(width_m=0.64, pixels=64)
    return SeenCloth(camera, np.where(height_m > 0.0, 1.0 - height_m, 0.0), height_m > 0.0, 0.0)


def test_a_vertex_beside_steep_cloth_goes_to_it_and_not_below_it(steep):
    """Beside a steep sheet, the nearest allowed place is to the side."""
    on = steep.points[np.abs(steep.points[:, 2] - 0.3).argmin()]
    vertices = (on + [0.004, 0.0, 0.004])[None]
    moved = steep.confined(vertices)
    assert np.linalg.norm(moved - vertices) <= np.linalg.norm(on - vertices) + 1e-9
    assert moved[0, 2] > on[2] - 0.005


def test_a_jittered_steep_sheet_does_not_sink(steep, rng):
    """Small errors of both signs leave the mean height of a hanging sheet where it is."""
    vertices = steep.points
    for _ in range(10):
        vertices = steep.confined(vertices + rng.normal(0.0, 0.004, vertices.shape))
    assert vertices[:, 2].mean() == pytest.approx(steep.points[:, 2].mean(), abs=0.02)
