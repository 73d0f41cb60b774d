"""The simulated camera: exact without noise, and wrong by as much as it says with it."""

import numpy as np
import pytest

from clothtrack.garments.garment_meshes import towel
from clothtrack.reconstruction.data.sensor_noise import SensorConfig, depth_noise
from clothtrack_lab.world.appearance import CLOTH_COLORS, Appearance
from clothtrack_lab.world.scene import CLOTH, TABLE, TOOL, Scene
from clothtrack_lab.world.sensor import Sensor, top_down_camera
from clothtrack_lab.world.tool import Tool

SMALL = {"width": 160, "height": 120, "focal": 150.0}


def make_scene(config: SensorConfig, *, lift: float = 0.05) -> tuple[Scene, np.ndarray]:
    camera = top_down_camera(config, np.random.default_rng(5))
    mesh = towel(0.2, 0.2, 0.02)
    return Scene(mesh, Tool(), camera), mesh.vertices + np.array([0.0, 0.0, lift])


def test_perfect_depth_is_the_analytic_plane() -> None:
    config = SensorConfig.perfect(**SMALL)
    scene, vertices = make_scene(config)
    depth = Sensor(scene, config, Appearance(), seed=0).capture(vertices, None).depth
    camera = scene.camera
    heights = camera.back_project(depth)[:, 2].reshape(depth.shape)
    cloth = scene.view(vertices, None).label == CLOTH
    assert cloth.any()
    assert not cloth.all()
    assert np.abs(heights[~cloth]).max() < 1e-5
    assert np.abs(heights[cloth] - 0.05).max() < 1e-5


def test_white_noise_has_the_promised_size_and_grows_with_the_square_of_depth() -> None:
    config = SensorConfig.perfect(white_m=0.001)
    shape = (300, 400)
    spread = []
    for z in (0.75, 1.5):
        depth = np.full(shape, z, dtype=np.float32)
        rng = np.random.default_rng(1)
        spread.append(depth_noise(depth, np.ones(shape), np.zeros(shape), config, rng).std())
    assert spread[0] == pytest.approx(0.001, rel=0.02)
    assert spread[1] == pytest.approx(0.004, rel=0.02)


def test_tool_hides_cloth_and_leaves_through_the_border() -> None:
    config = SensorConfig.perfect(**SMALL)
    scene, vertices = make_scene(config)
    bare = scene.view(vertices, None).label
    hidden = scene.view(vertices, np.array([0.0, 0.0, 0.06])).label
    assert ((bare == CLOTH) & (hidden == TOOL)).sum() > 20
    assert (hidden[0] == TOOL).any()
    away = scene.out_of_picture(np.array([0.0, 0.0, 0.06]))
    assert np.array_equal(scene.view(vertices, away).label, bare)


@pytest.mark.parametrize("name", CLOTH_COLORS)
def test_cloth_table_and_tool_differ_by_color(name: str) -> None:
    config = SensorConfig.perfect(**SMALL)
    scene, vertices = make_scene(config)
    tip = np.array([0.0, 0.0, 0.06])
    color = Sensor(scene, config, Appearance(cloth=name), seed=0).capture(vertices, tip).color
    label = scene.view(vertices, tip).label
    strength = color.astype(float) / np.maximum(color.sum(axis=2, keepdims=True), 1)
    means = [np.median(strength[label == kind], axis=0) for kind in (TABLE, CLOTH, TOOL)]
    assert np.abs(means[1] - means[0]).max() > 0.15
    assert np.abs(means[1] - means[2]).max() > 0.15
    assert np.abs(means[0] - means[2]).max() > 0.05
