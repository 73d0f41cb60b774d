"""Surface samples lie on the surface and are spread over its area."""

import numpy as np

from clothtrack.geometry.chamfer import sample_surface


def test_samples_lie_on_the_triangles_and_follow_the_area():
    vertices = np.array([[0.0, 0, 1], [3, 0, 1], [0, 3, 1], [10, 0, 2], [11, 0, 2], [10, 1, 2]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])  # areas 4.5 and 0.5
    points = sample_surface(vertices, faces, 20_000, seed=4)
    large = points[:, 2] < 1.5
    assert large.mean() == np.clip(large.mean(), 0.89, 0.91)
    np.testing.assert_allclose(points[large, 2], 1)
    np.testing.assert_allclose(points[~large, 2], 2)
    x, y = points[large, 0], points[large, 1]
    assert min(x.min(), y.min()) >= 0
    assert (x + y).max() <= 3
    # Uniform: the centroid is the triangle's, and a corner cut at half height holds a quarter.
    np.testing.assert_allclose([x.mean(), y.mean()], [1, 1], atol=0.03)
    np.testing.assert_allclose((x > 1.5).mean(), 0.25, atol=0.01)
