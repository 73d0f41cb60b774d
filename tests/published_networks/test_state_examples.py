"""Examples of simulated states: picture, labels and points say the same, however turned."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.garments.garment_meshes import garment
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.reconstruction.data.state_store import StateShard, open_states, write_states
from clothtrack.reconstruction.data.view import crop
from clothtrack_lab.published_networks.examples import ExampleConfig, Garment, draw_example
from clothtrack_lab.published_networks.network_config import NetworkConfig
from clothtrack_lab.published_networks.rendered_state import render
from clothtrack_lab.published_networks.state_examples import StateExamples
from clothtrack_lab.published_networks.winding import WindingConfig, winding_numbers

NETWORK = NetworkConfig()
EXACT = SensorConfig.perfect()
PERFECT = RenderConfig(sensors=(EXACT,) * 3, mask_jitter=0.0, tool=0.0, cut=0.0)
CONFIG = ExampleConfig(surface_queries=4096, winding=WindingConfig(pool=4096))


def crumpled(mesh, seed=0, amplitude=0.02):
    """The flat cloth, turned, bent into waves and with one side folded over the other."""
    rng = np.random.default_rng(seed)
    x, y, z = np.asarray(mesh.vertices, np.float64).T
    line = 0.25 * np.ptp(x) + x.min()
    folded = x < line
    x = np.where(folded, 2 * line - x, x)
    z = z + np.where(folded, 0.012, 0.0)
    waves = rng.uniform(20, 40, 2)
    z = z + amplitude * (1 + np.sin(waves[0] * x) * np.cos(waves[1] * y))
    angle = rng.uniform(-np.pi, np.pi)
    turned = np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y
    return np.column_stack([*turned, z + 0.005])


def states(folder, kind="tshirt", count=4, vertices=600, shards=2):
    parts = []
    for number in range(shards):
        mesh = garment(kind, vertex_count=vertices, seed=number)
        positions = np.stack([crumpled(mesh, seed=k) for k in range(count)]).astype(np.float32)
        episodes = np.arange(count) // 2
        parts.append(StateShard(kind, mesh, positions, episodes, ("drop",) * count, number))
    return write_states(folder, kind, parts, {})


@pytest.fixture(scope="module")
def shirts(tmp_path_factory):
    return states(tmp_path_factory.mktemp("states") / "shirts")


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_pixels_points_and_labels_agree(tmp_path, kind):
    """A pixel's canonical coordinate leads to the material point that was measured there."""
    examples = StateExamples(
        [states(tmp_path, kind, shards=1)], NETWORK, CONFIG, rendering=PERFECT, seed=4
    )
    for index in range(4):
        example = examples[index, 7 * index]
        assert example.labeled.mean() > 0.97
        gap, nearest = cKDTree(example.surface).query(example.unit[example.labeled])
        assert np.percentile(gap, 90) < 0.012
        # Material points a few millimeters apart on the cloth lie a few millimeters apart.
        way = np.linalg.norm(example.positions[nearest] - example.points[example.labeled], axis=1)
        assert np.median(way) < 0.006
        assert np.percentile(way, 95) < 0.015


def drawn_picture(angle=0.0, mirror=False, seed=2):
    mesh = garment("tshirt", vertex_count=600)
    picture = render(crumpled(mesh), mesh, PERFECT, np.random.default_rng(seed))
    picture = picture.mirrored() if mirror else picture
    return picture.turned(angle)


def view_of(picture):
    return crop(picture.depth_m, picture.mask, picture.camera, NETWORK).depth


def test_a_mirrored_picture_is_the_picture_of_the_mirrored_cloth():
    plain, mirrored = view_of(drawn_picture()), view_of(drawn_picture(mirror=True))
    both = (plain[:, ::-1] > 0) & (mirrored > 0)
    assert both.sum() > 0.98 * (mirrored > 0).sum()
    gap = np.abs(plain[:, ::-1][both] - mirrored[both])
    assert np.percentile(gap, 99) < 1e-3
    twice = drawn_picture(mirror=True).mirrored()
    np.testing.assert_allclose(
        twice.camera.world_from_camera, drawn_picture().camera.world_from_camera, atol=1e-12
    )


def test_winding_numbers_are_those_of_the_labeled_garment():
    mesh = garment("tshirt", vertex_count=600)
    labels = Garment.of(mesh, "tshirt", CONFIG.winding, seed=0)
    picture = render(crumpled(mesh), mesh, PERFECT, np.random.default_rng(0))
    for seed in range(4):
        example = draw_example(picture, labels, NETWORK, CONFIG, np.random.default_rng(seed))
        mirror = np.random.default_rng(seed).random() < 0.5
        unit, faces = labels.unit.copy(), mesh.faces
        if mirror:
            unit[:, 0], faces = 1.0 - unit[:, 0], mesh.faces[:, ::-1]
        expected = winding_numbers(unit, faces, example.volume)
        np.testing.assert_allclose(example.winding, expected, atol=0.03)


def test_an_example_is_a_function_of_index_epoch_and_seed(shirts):
    first, again = (StateExamples([shirts], NETWORK, CONFIG, seed=3) for _ in range(2))
    other = StateExamples([shirts], NETWORK, CONFIG, seed=4)
    again[5, 0]
    one, same = first[2, 1], again[2, 1]
    for name in one.__annotations__:
        np.testing.assert_array_equal(getattr(one, name), getattr(same, name), err_msg=name)
    assert not np.array_equal(one.depth, first[2, 2].depth)
    assert not np.array_equal(one.depth, other[2, 1].depth)


def test_a_label_far_from_the_mesh_is_cut():
    mesh = garment("towel", vertex_count=600)
    labels = Garment.of(mesh, "towel", CONFIG.winding, seed=0)
    flat = np.asarray(mesh.vertices) + (0.0, 0.0, 0.005)
    picture = render(flat, mesh, PERFECT, np.random.default_rng(1))
    half = np.zeros_like(picture.mask)
    half[: len(half) // 2] = True
    raised = picture.depth_m - np.where(half, 0.03, 0.0)
    moved = type(picture)(raised, picture.mask, picture.camera, picture.faces, picture.positions)
    config = ExampleConfig(cut_m=0.02, winding=CONFIG.winding)
    example = draw_example(moved, labels, NETWORK, config, np.random.default_rng(0))
    high = example.points[:, 2] > 0.02
    assert 0.2 < high.mean() < 0.8
    assert not example.labeled[high].any()
    assert example.labeled[~high].mean() > 0.9
    assert (example.unit[~example.labeled] == 0.0).all()


def test_states_of_two_kinds_are_refused(shirts, tmp_path):
    towels = states(tmp_path / "towels", "towel", shards=1)
    with pytest.raises(InvalidConfigError, match="towel, tshirt"):
        StateExamples([shirts, towels], NETWORK)


def test_a_state_that_cannot_be_rendered_is_replaced_by_another(tmp_path):
    mesh = garment("towel", vertex_count=300)
    # All vertices within a tenth of a millimeter: no camera measures cloth there.
    nothing = (1e-4 * np.asarray(mesh.vertices) + [0.0, 0.0, 0.005]).astype(np.float32)
    whole = crumpled(mesh).astype(np.float32)
    for name, positions in (("one", [nothing, whole, whole, whole]), ("all", [nothing] * 4)):
        shard = StateShard("towel", mesh, np.stack(positions), np.arange(4), ("drop",) * 4, 0)
        write_states(tmp_path / name, "towel", [shard], {})
    one, every = (
        StateExamples([open_states(tmp_path / name)], NETWORK, CONFIG, rendering=PERFECT, seed=2)
        for name in ("one", "all")
    )
    example = one[0, 0]
    assert np.ptp(example.positions, axis=0).max() > 0.2
    np.testing.assert_array_equal(example.depth, one[0, 0].depth)
    with pytest.raises(InvalidRecordingError, match=r"0000\.zarr, state \d: camera 'top'"):
        every[0, 0]
