"""Pictures that PyTorch renders in batches are those that Warp and NumPy render one by one."""

import cv2
import numpy as np
import pytest
import torch
from seen_above import waved

from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.data import batch_view
from clothtrack.reconstruction.data.batch_draws import draw_scenes
from clothtrack.reconstruction.data.batch_pictures import Cloths, measure
from clothtrack.reconstruction.data.batch_rows import rows_of
from clothtrack.reconstruction.data.batch_sensor import (
    measured_depth,
)
from clothtrack.reconstruction.data.batch_view import above, on_mesh
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture, faces_of_points
from clothtrack.reconstruction.data.render_config import SENSORS, RenderConfig
from clothtrack.reconstruction.data.sensor_noise import SensorConfig, depth_noise
from clothtrack.reconstruction.data.view import cloth_pixels, crop, points_of
from clothtrack.reconstruction.tokens.token_network import TokenNetworkConfig

NETWORK = TokenNetworkConfig()
EXACT = SensorConfig.perfect()
PERFECT = RenderConfig(sensors=(EXACT,) * 3, mask_jitter=0.0, tool=0.0, cut=0.0)
MESHES = {
    "towel": garment("towel", vertex_count=500, size_m=(0.5, 0.3), pattern="random"),
    "tshirt": garment("tshirt", vertex_count=900),
}


def cloths_of(kind, count, config, seed=0):
    positions = torch.from_numpy(
        np.stack(
            [waved(MESHES[kind], seed + one, (0.15, 0.4), (15, 30), 0.02) for one in range(count)]
        )
    )
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


def test_pictures_drawn_together_are_those_drawn_alone():
    """In a batch of other sizes a picture has more table around it, and is the same."""
    _, cloths = cloths_of("tshirt", 6, PERFECT)
    together = measure(cloths, torch.Generator())
    for number in range(6):
        alone = measure(rows_of(cloths, torch.tensor([number])), torch.Generator())
        width, height = cloths.size[number].tolist()
        torch.testing.assert_close(together.face[number, :height, :width], alone.face[0])
        assert int(together.mask[number].sum()) == int(alone.mask[0].sum())


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
