import numpy as np
import pytest

from clothtrack.recordings.recording import Table
from clothtrack.report.palette import INSIDE, OUTSIDE
from clothtrack.report.shading import Shader, ShadingConfig
from clothtrack.report.viewpoint import look_at

FLAT = ShadingConfig(edge_darkening=0.0, depth_darkening=0.0)
SQUARE = np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [-0.1, 0.1, 0], [0.1, 0.1, 0]], dtype=float)
FACES = np.array([[0, 1, 2], [1, 3, 2]])


def above(width=81, height=61):
    return look_at(np.array([0.0, 0.0, 0.5]), np.zeros(3), width=width, height=height)


def shown(still, row=30, column=40):
    return still.image[row, column] / 255


@pytest.mark.parametrize(("faces", "hue"), [(FACES, OUTSIDE), (FACES[:, ::-1], INSIDE)])
def test_each_side_has_its_hue_and_lambert_brightness(faces, hue):
    config = ShadingConfig(edge_darkening=0.0, depth_darkening=0.0, light=(0.0, 0.6, -0.8))
    still = Shader(faces, above(), config=config).render(SQUARE)
    brightness = config.ambient + (1.08 - config.ambient) * 0.8
    np.testing.assert_allclose(shown(still), np.clip(np.multiply(hue, brightness), 0, 1), atol=4e-3)


def test_vertex_colors_are_linear_over_the_cloth():
    config = ShadingConfig(edge_darkening=0.0, depth_darkening=0.0, ambient=1.08)
    colors = np.repeat((SQUARE[:, :1] + 0.1) / 0.2 * 0.8, 3, axis=1)
    camera = above()
    still = Shader(FACES, camera, config=config).render(SQUARE, colors=colors)
    columns = np.flatnonzero(still.cloth[30])
    x = (columns - camera.cx) / camera.fx * 0.5
    expected = (x + 0.1) / 0.2 * 0.8 * 1.08
    np.testing.assert_allclose(still.image[30, columns, 0] / 255, expected, atol=4e-3)


def test_a_layer_pushed_through_another_shows_as_the_other_hue():
    lower = SQUARE - (0.0, 0.0, 0.01)
    vertices = np.concatenate([SQUARE, lower])
    faces = np.concatenate([FACES, FACES[:, ::-1] + 4])
    shader = Shader(faces, above(), config=FLAT)
    whole = shader.render(vertices).image
    vertices[4:, 2] += 0.02
    pierced = shader.render(vertices).image
    assert whole[30, 40, 2] > whole[30, 40, 0]
    assert pierced[30, 40, 0] > pierced[30, 40, 2]


def test_the_table_hides_what_is_under_it():
    table = Table(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    shader = Shader(FACES, above(), table=table)
    assert shader.render(SQUARE + np.array([0, 0, 0.01])).cloth.any()
    assert not shader.render(SQUARE - np.array([0, 0, 0.05])).cloth.any()


def test_a_step_between_layers_is_drawn_dark():
    upper = SQUARE * (0.5, 0.5, 1.0) + np.array([0, 0, 0.02])
    vertices, faces = np.concatenate([SQUARE, upper]), np.concatenate([FACES, FACES + 4])
    camera = above(161, 121)
    plain = Shader(faces, camera, config=FLAT).render(vertices).image.astype(int)
    drawn = Shader(faces, camera, config=ShadingConfig(depth_darkening=0.0)).render(vertices).image
    darker = plain[60].sum(axis=1) - drawn[60].sum(axis=1, dtype=int) > 60
    edge = camera.cx + camera.fx * 0.05 / 0.48
    assert np.abs(np.flatnonzero(darker) - edge).min() <= 1.5
    assert not darker[75:85].any()
