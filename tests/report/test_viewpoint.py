import numpy as np
import pytest

from clothtrack.report.viewpoint import look_at, three_quarter_view


@pytest.mark.parametrize(
    "eye", [(0.5, -0.4, 0.3), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (-2.0, 0.1, 0.0)]
)
def test_the_target_is_in_the_middle_and_up_is_up(eye):
    camera = look_at(np.array(eye), np.zeros(3), width=101, height=81)
    pixels, depth = camera.project(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.05]]))
    np.testing.assert_allclose(pixels[0], (50, 40), atol=1e-9)
    np.testing.assert_allclose(depth[0], np.linalg.norm(eye))
    assert pixels[1, 1] <= pixels[0, 1] + 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_a_three_quarter_view_holds_everything_and_wastes_little(seed):
    generator = np.random.default_rng(seed)
    points = generator.normal(size=(200, 3)) * generator.uniform(0.02, 0.5, 3) + generator.normal(
        size=3
    )
    camera = three_quarter_view(points, width=320, height=240)
    pixels, depth = camera.project(points)
    size = np.array([320, 240])
    assert (depth > 0).all()
    assert (pixels > -0.5).all()
    assert (pixels < size - 0.5).all()
    assert (np.ptp(pixels, axis=0) / size).max() > 0.75
    assert camera.position[2] > points[:, 2].mean()
