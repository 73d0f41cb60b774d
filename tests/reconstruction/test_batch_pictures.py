"""Pictures that PyTorch renders in batches are those that Warp and NumPy render one by one."""

import cv2
import numpy as np
import pytest
import torch

from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.data import batch_view
from clothtrack.reconstruction.data.batch_draws import draw_scenes
from clothtrack.reconstruction.data.batch_pictures import Cloths, Measured, measure
from clothtrack.reconstruction.data.batch_raster import Projected, nearest_faces, unpacked
from clothtrack.reconstruction.data.batch_rows import rows_of
from clothtrack.reconstruction.data.batch_sensor import (
    cut_off,
    flying,
    hidden_by_tools,
    jittered,
    measured_depth,
    waves,
)
from clothtrack.reconstruction.data.batch_surface import on_mesh
from clothtrack.reconstruction.data.batch_view import above
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture, faces_of_points
from clothtrack.reconstruction.data.render_config import SENSORS, RenderConfig
from clothtrack.reconstruction.data.sensor_noise import SensorConfig, depth_noise
from clothtrack.reconstruction.data.view import cloth_pixels, crop, points_of
from clothtrack.reconstruction.tokens.token_network import TokenNetworkConfig
from clothtrack.recordings.camera_view import flying_pixels
from clothtrack_lab.published_networks.rendered_state import render

NETWORK = TokenNetworkConfig()
EXACT = SensorConfig.perfect()
PERFECT = RenderConfig(sensors=(EXACT,) * 3, mask_jitter=0.0, tool=0.0, cut=0.0)
MESHES = {
    "towel": garment("towel", vertex_count=500, size_m=(0.5, 0.3), pattern="random"),
    "tshirt": garment("tshirt", vertex_count=900),
}


def folded(kind, seed=0):
    """The garment turned, bent into waves, with one side laid over the rest."""
    rng = np.random.default_rng(seed)
    x, y, z = np.asarray(MESHES[kind].vertices, np.float64).T
    line = x.min() + rng.uniform(0.15, 0.4) * np.ptp(x)
    over = x < line
    x, z = np.where(over, 2 * line - x, x), z - z.min() + 0.012 * over
    wave = rng.uniform(15, 30, 2)
    z = z + 0.02 * (1 + np.sin(wave[0] * x) * np.cos(wave[1] * y)) + 0.002
    turn = rng.uniform(-np.pi, np.pi)
    level = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    return np.column_stack([*level, z]).astype(np.float32)


def cloths_of(kind, count, config, seed=0):
    positions = torch.from_numpy(np.stack([folded(kind, seed + one) for one in range(count)]))
    draws = torch.Generator().manual_seed(seed)
    scenes = draw_scenes(positions.amin(1), positions.amax(1), config, draws)
    faces = torch.from_numpy(MESHES[kind].faces.T.astype(np.int64)).expand(count, -1, -1)
    return positions.numpy(), Cloths.before(positions, faces, scenes)


def camera_of(cloths, number):
    """The camera of one cloth, as Warp and NumPy take it."""
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(cloths.scenes.rotation[number].double().numpy())[0]
    pose[:3, :3] *= np.sign((pose[:3, :3] * cloths.scenes.rotation[number].numpy()).sum(0))
    pose[:3, 3] = cloths.scenes.position[number].numpy()
    focal = float(cloths.scenes.focal[number])
    first, size = cloths.first[number].tolist(), cloths.size[number].tolist()
    return Camera("top", size[0], size[1], focal, focal, -first[0], -first[1], pose)


def measured_alone(kind, count=6, config=PERFECT, seed=0):
    """Each cloth with its picture, one at a time."""
    positions, cloths = cloths_of(kind, count, config, seed)
    noise = torch.Generator().manual_seed(seed)
    for number in range(count):
        alone = rows_of(cloths, torch.tensor([number]))
        yield positions[number], camera_of(cloths, number), measure(alone, noise)


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_the_rasterizer_is_that_of_warp(kind):
    shown = same = 0
    for positions, camera, picture in measured_alone(kind):
        expected = Rasterizer(MESHES[kind].faces, camera).render(positions)
        face = picture.face[0].numpy()
        either = (face >= 0) | (expected.faces >= 0)
        shown, same = shown + either.sum(), same + (face == expected.faces)[either].sum()
        both = (face >= 0) & (expected.faces >= 0)
        # The perfect sensor measures whole micrometers.
        gap = np.abs(picture.depth[0].numpy() - expected.depth)[both]
        assert np.percentile(gap, 99.9) < 1e-4
    assert same / shown > 0.995


def drawn(columns, rows, depth, faces, shape):
    points = Projected(*(torch.tensor(one) for one in (columns, rows, [1.0 / d for d in depth])))
    corners = torch.tensor(faces).T
    keys = nearest_faces(points, corners, torch.zeros(len(faces), dtype=torch.int64), shape)
    depth, face = unpacked(keys)
    return depth.view(shape).numpy(), face.view(shape).numpy()


def test_a_face_larger_than_its_picture_covers_it_whole():
    depth, face = drawn(
        [-900.0, 2_000.0, -900.0], [-900.0, -900.0, 2_000.0], [1.0, 1.0, 1.0], [[0, 1, 2]],
        (1, 300, 400),
    )  # fmt: skip
    assert (face == 0).all()
    np.testing.assert_allclose(depth, 1.0, rtol=1e-6)


def test_the_nearest_face_wins_and_seams_are_closed():
    columns, rows = [0.0, 9.0, 9.0, 0.0, 0.0, 9.0, 9.0], [0.0, 0.0, 9.0, 9.0, 0.0, 0.0, 9.0]
    depth = [2.0, 2.0, 2.0, 2.0, 1.0, 1.0, 1.0]
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    _, face = drawn(columns, rows, depth, faces, (1, 10, 10))
    # The square of the first two has no hole along its diagonal; the third hides the first.
    assert set(np.unique(face)) == {1, 2}
    assert (face >= 0).all()
    assert (np.triu(np.ones((10, 10))) == (face == 2)).all()


def test_what_has_no_area_or_lies_behind_the_camera_is_not_drawn():
    columns, rows = [0.0, 5.0, 9.0, 0.0, 9.0, 0.0], [5.0, 5.0, 5.0, 0.0, 0.0, 9.0]
    depth = [1.0, 1.0, 1.0, 1.0, 1.0, -1.0]
    _, face = drawn(columns, rows, depth, [[0, 1, 2], [3, 4, 5], [0, 0, 0]], (1, 10, 10))
    assert (face == -1).all()


def test_pictures_drawn_together_are_those_drawn_alone():
    """In a batch of other sizes a picture has more table around it, and is the same."""
    _, cloths = cloths_of("tshirt", 6, PERFECT)
    together = measure(cloths, torch.Generator())
    for number in range(6):
        alone = measure(rows_of(cloths, torch.tensor([number])), torch.Generator())
        width, height = cloths.size[number].tolist()
        torch.testing.assert_close(together.face[number, :height, :width], alone.face[0])
        assert int(together.mask[number].sum()) == int(alone.mask[0].sum())
    sizes = [len(part) for part in cloths.parts(3 * int(cloths.size.prod(1).max()))]
    assert sum(sizes) == 6
    assert 1 < len(sizes) < 6
    order = torch.cat(list(cloths.parts(1)))
    assert sorted(order.tolist()) == list(range(6))


def test_cameras_are_drawn_as_those_of_single_states():
    """Height, slant and size of the pictures of many cameras each, as means and spreads."""
    positions, cloths = cloths_of("towel", 1, RenderConfig())
    low, high = (
        torch.tensor(one).expand(400, -1) for one in (positions[0].min(0), positions[0].max(0))
    )
    scenes = draw_scenes(low, high, RenderConfig(), torch.Generator().manual_seed(1))
    batch = Cloths.before(
        torch.from_numpy(positions).expand(400, -1, -1), cloths.faces.expand(400, -1, -1), scenes
    )
    found = np.column_stack(
        [scenes.position[:, 2], scenes.rotation[:, 2, 2], scenes.focal, batch.size.amax(1)]
    )
    rng = np.random.default_rng(2)
    singles = [
        render(positions[0].astype(float), MESHES["towel"], PERFECT, rng).camera for _ in range(200)
    ]
    expected = np.array(
        [[c.position[2], c.world_from_camera[2, 2], c.fx, max(c.width, c.height)] for c in singles]
    )
    spread = expected.std(0)
    # Four standard errors of a difference of means.
    assert (
        np.abs(found.mean(0) - expected.mean(0)) < 4 * spread * (1 / 200 + 1 / 400) ** 0.5
    ).all()
    np.testing.assert_allclose(found.std(0), spread, rtol=0.25)


def stepped(shape=(120, 160)):
    """A level surface, a step of 3 cm in the middle, and a surface seen at a slant beyond."""
    depth = np.full(shape, 0.9, np.float32)
    depth[:, shape[1] // 2 :] = 0.93
    facing = np.ones(shape, np.float32)
    facing[:, 3 * shape[1] // 4 :] = 0.1
    return depth, facing


@pytest.mark.parametrize("config", SENSORS.values(), ids=SENSORS)
def test_each_sensor_measures_as_badly_as_that_of_a_single_picture(config):
    depth, facing = stepped()
    wave = cv2.resize(
        np.random.default_rng(0).standard_normal((5, 6)).astype(np.float32), (160, 120)
    )
    expected = np.stack(
        [depth_noise(depth, facing, wave, config, np.random.default_rng(n)) for n in range(40)]
    )
    kinds = RenderConfig(noise_range=(1.0, 1.0), sensors=(config,) * 3)
    box = torch.zeros(40, 3), torch.ones(40, 3)
    scenes = draw_scenes(*box, kinds, torch.Generator().manual_seed(0))
    repeated = [torch.from_numpy(one).expand(40, -1, -1) for one in (depth, facing, wave)]
    found = measured_depth(*repeated, scenes, torch.Generator().manual_seed(1)).numpy()
    level, edge, slanted = np.s_[:, :, 5:70], np.s_[:, :, 79:81], np.s_[:, :, 125:]
    for part in (level, edge, slanted):
        lost = [(one[part] == 0).mean() for one in (found, expected)]
        assert lost[0] == pytest.approx(lost[1], abs=0.01)
        # Four standard errors of a difference of means, and what rounding adds.
        known = [one[part][one[part] > 0] for one in (found, expected)]
        spread = float(known[1].std())
        tolerance = 4.0 * spread * (2.0 / len(known[1])) ** 0.5 + 1e-6
        assert known[0].mean() == pytest.approx(known[1].mean(), abs=tolerance)
        assert known[0].std() == pytest.approx(spread, rel=0.03)
    steps = [np.unique(np.round(1e6 / one[level][one[level] > 0])) for one in (found, expected)]
    assert len(set(steps[0]) ^ set(steps[1])) <= 0.4 * len(steps[1])


def test_slow_errors_are_spread_as_opencv_resizes():
    coarse = np.random.default_rng(3).standard_normal((2, 5, 6)).astype(np.float32)
    sizes = np.array([[80, 100], [57, 133]])
    found = waves(
        torch.from_numpy(coarse), *(torch.tensor(one).float() for one in sizes.T), (80, 133)
    )
    for number, (height, width) in enumerate(sizes):
        expected = cv2.resize(
            coarse[number], (int(width), int(height)), interpolation=cv2.INTER_CUBIC
        )
        np.testing.assert_allclose(found[number, :height, :width], expected, atol=1e-4)


def test_flying_pixels_are_those_of_single_pictures():
    rng = np.random.default_rng(4)
    depth = np.cumsum(rng.choice([0.0, 0.0, 0.02, -0.02], (3, 60, 70)), axis=2) + 1.5
    depth = np.where(rng.random(depth.shape) < 0.05, 0.0, depth).astype(np.float32)
    focal = torch.tensor([200.0, 300.0, 450.0])
    found = flying(torch.from_numpy(depth), focal).numpy()
    assert 0.01 < found.mean() < 0.5
    for number in range(3):
        np.testing.assert_array_equal(
            found[number], flying_pixels(depth[number], float(focal[number]))
        )


def test_masks_grow_and_shrink_as_those_of_single_pictures():
    masks = np.zeros((7, 60, 70), bool)
    masks[:, 15:40, 12:50] = np.random.default_rng(5).random((7, 25, 38)) < 0.97
    grown = torch.tensor([-3, -2, -1, 0, 1, 2, 3], dtype=torch.int32)
    found = jittered(torch.from_numpy(masks), grown).numpy()
    for number, pixels in enumerate(grown.tolist()):
        change = cv2.dilate if pixels > 0 else cv2.erode
        kernel = np.ones((1 + 2 * abs(pixels),) * 2, np.uint8)
        expected = change(masks[number].astype(np.uint8), kernel).astype(bool)
        np.testing.assert_array_equal(found[number], expected)


def test_borders_cut_off_the_share_that_they_are_said_to():
    mask = np.zeros((60, 70), bool)
    mask[10:50, 20:60] = True
    masks = torch.from_numpy(mask).expand(5, -1, -1)
    side = torch.tensor([0, 1, 2, 3, -1], dtype=torch.int32)
    found = cut_off(masks, side, torch.full((5,), 0.2)).numpy()
    rows, columns = np.indices(mask.shape)
    for number, along in enumerate((columns, rows, -columns, -rows)):
        expected = along > np.quantile(along[mask], 0.8)
        np.testing.assert_array_equal(found[number] & mask, expected & mask)
    assert not found[4].any()


def test_a_tool_hides_a_line_as_thick_as_it_is():
    _, cloths = cloths_of("towel", 4, RenderConfig(tool=1.0))
    tips = torch.tensor([[60.0, 50.0], [20.0, 30.0], [99.0, 10.0], [70.0, 60.0]])
    radius = torch.tensor([8.0, 5.0, 3.0, 11.0])
    found = hidden_by_tools(tips, radius, cloths.scenes, (100, 120)).numpy()
    for number in range(4):
        angle = float(cloths.scenes.tip_angle[number])
        end = tips[number].numpy()
        if cloths.scenes.reaches[number]:
            end = end + 220 * np.array([np.cos(angle), np.sin(angle)])
        expected = np.zeros((100, 120), np.uint8)
        tip = tips[number].int().tolist()
        cv2.line(expected, tip, end.astype(int).tolist(), 1, round(2 * float(radius[number])))
        both = (found[number] & (expected > 0)).sum()
        assert both / (found[number] | (expected > 0)).sum() > 0.85


def labeled(positions, camera, picture):
    """The picture of one cloth, as the functions of single pictures take it."""
    parts = (one[0].numpy() for one in (picture.depth, picture.mask))
    return LabeledPicture(*parts, camera, picture.face[0].numpy(), positions.astype(float))


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_the_view_from_above_is_that_of_a_single_picture(kind, monkeypatch):
    # The camera's place is taken from all pixels.
    monkeypatch.setattr(batch_view, "LATTICE", 1_000)
    for positions, camera, picture in measured_alone(kind, config=RenderConfig()):
        single = crop(picture.depth[0].numpy(), picture.mask[0].numpy(), camera, NETWORK)
        views = above(picture, torch.eye(3)[None], NETWORK)
        np.testing.assert_allclose(views.position[0], single.camera.position, atol=2e-5)
        found = views.depth[0].numpy()
        assert ((found > 0) == single.mask).mean() > 0.998
        both = (found > 0) & single.mask
        assert np.percentile(np.abs(found - single.depth)[both], 99) < 1e-4
        seen = cloth_pixels(single.depth, NETWORK)
        points = points_of(single.depth, single.camera, seen.sources)
        local = camera.camera_from_world_points(points).astype(np.float32)
        at = views.points(torch.from_numpy(seen.sources)[None])[0].numpy()
        assert np.percentile(np.abs(at - local).max(1), 95) < 1e-3
        single = labeled(positions, camera, picture)
        _check_faces(local, points, single, picture, MESHES[kind].faces)


def _check_faces(local, points, single, picture, faces):
    """Points lie on the mesh where the functions of single pictures say."""
    face, weights, _ = faces_of_points(points, single, faces, cut_m=0.02)
    found = on_mesh(torch.from_numpy(local)[None], picture)
    same = (found.corners[0].numpy() == faces[face]).all(axis=1)
    assert same[face >= 0].mean() > 0.99
    gap = np.abs(found.weights[0].numpy() - weights)[same & (face >= 0)]
    assert np.percentile(gap, 99) < 2e-3
    assert (torch.isinf(found.apart[0]).numpy() == (face < 0)).mean() > 0.99


def test_a_lattice_of_pixels_puts_the_camera_where_all_of_them_do(monkeypatch):
    for _, _, picture in measured_alone("tshirt", config=RenderConfig()):
        found = above(picture, torch.eye(3)[None], NETWORK).position[0]
        with monkeypatch.context() as patched:
            patched.setattr(batch_view, "LATTICE", 1_000)
            expected = above(picture, torch.eye(3)[None], NETWORK).position[0]
        # A hundredth of the height, which is as the picture's width, is 1.3 of its pixels.
        assert (found - expected).abs().max() < 0.01 * expected[2]


def test_a_turned_and_mirrored_world_is_seen_turned_and_mirrored():
    ((_, _, picture),) = measured_alone("tshirt", 1)
    plain = above(picture, torch.eye(3)[None], NETWORK).depth[0]
    mirror = above(picture, torch.diag(torch.tensor([-1.0, 1.0, 1.0]))[None], NETWORK).depth[0]
    quarter = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = above(picture, quarter[None], NETWORK).depth[0]
    for found, expected in ((mirror, plain.flip(1)), (turned, plain.rot90())):
        both = (found > 0) & (expected > 0)
        assert both.sum() > 0.97 * torch.maximum((found > 0).sum(), (expected > 0).sum())
        assert (found - expected)[both].abs().mean() < 5e-4


def test_a_picture_without_cloth_is_said_to_have_none():
    ((_, _, picture),) = measured_alone("towel", 1)
    none = Measured(
        picture.cloths, picture.depth, torch.zeros_like(picture.mask), picture.face,
        picture.across, picture.down,
    )  # fmt: skip
    views = above(none, torch.eye(3)[None], NETWORK)
    assert not bool(views.is_cloth[0])
    assert not bool(views.depth.any())
    assert torch.isfinite(views.position).all()
