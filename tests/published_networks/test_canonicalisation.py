import numpy as np
import pytest
import torch
from torch.nn import functional

from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.visibility import Rasterizer
from clothtrack.reconstruction.data.view import cloth_pixels, view_camera
from clothtrack.reconstruction.first_mesh import symmetries
from clothtrack_lab.published_networks.canonical_frame import canonical_frame
from clothtrack_lab.published_networks.canonicalisation import (
    Canonicaliser,
    bin_of,
    canonical_loss,
    coordinates,
    relabeled,
    symmetry_losses,
)
from clothtrack_lab.published_networks.network_config import preset

SMALL = preset("small")


def logits_of(units, bins, sharpness=400.0):
    """A sure answer: a narrow bell over the bins around each coordinate."""
    centers = (torch.arange(bins) + 0.5) / bins
    return -sharpness * bins * (units[..., None] - centers) ** 2


def random_logits(rng, pixels, bins=16):
    return torch.from_numpy(rng.normal(size=(pixels, 3, bins)).astype(np.float32))


def random_units(rng, pixels):
    return torch.from_numpy(rng.uniform(0.05, 0.95, (pixels, 3)).astype(np.float32))


def test_the_mean_of_the_window_is_finer_than_a_bin(rng):
    units = random_units(rng, 500)
    found, _ = coordinates(logits_of(units, 64, sharpness=30.0), window=3)
    assert (found - units).abs().max() < 0.05 * 0.5 / 64


def test_a_rival_answer_does_not_pull_the_coordinate_but_lowers_the_confidence():
    centers = torch.tensor([[0.2, 0.5, 0.8]])
    sure, rival = logits_of(centers, 64), logits_of(centers + 10 / 64, 64)
    found, confidence = coordinates(torch.logaddexp(sure, rival - 0.5))
    alone, certain = coordinates(sure)
    torch.testing.assert_close(found, alone)
    expected = 1.0 / (1.0 + np.exp(-0.5))
    np.testing.assert_allclose(confidence / certain, expected, atol=5e-3)


@pytest.mark.parametrize("kind", ["towel", "tshirt"])
def test_the_loss_does_not_change_when_the_cloth_is_relabeled(kind, rng):
    signs = torch.from_numpy(symmetries(kind)).float()
    logits, units = random_logits(rng, 60), random_units(rng, 60)
    image = torch.arange(60) % 3
    plain = canonical_loss(logits, units, image, signs, 3)
    for index, one in enumerate(signs):
        # Every picture may be relabeled by another member.
        moved = torch.where((image == 1)[:, None], relabeled(units, one), units)
        again = canonical_loss(logits, moved, image, signs, 3)
        torch.testing.assert_close(again, plain)
        identity_only = canonical_loss(logits, moved, image, signs[:1], 3)
        assert index == 0 or abs(identity_only - plain) > 1e-3


def test_the_loss_is_the_cross_entropy_without_symmetry(rng):
    logits, units = random_logits(rng, 30), random_units(rng, 30)
    loss = canonical_loss(logits, units, torch.zeros(30).long(), torch.ones(1, 3), 1)
    expected = functional.cross_entropy(logits.reshape(90, 16), bin_of(units, 16).reshape(90))
    torch.testing.assert_close(loss, expected)


def test_a_picture_without_cloth_does_not_count(rng):
    logits, units = random_logits(rng, 30), random_units(rng, 30)
    image = torch.where(torch.arange(30) < 10, 0, 2)
    signs = torch.ones(1, 3)
    each = symmetry_losses(logits, units, image, signs, 3)[:, 0]
    assert each[1] == 0
    loss = canonical_loss(logits, units, image, signs, 3)
    torch.testing.assert_close(loss, (each[0] + each[2]) / 2)


def test_a_batch_gives_what_its_pictures_give_alone(rng):
    network = Canonicaliser(SMALL).eval()
    depth = torch.from_numpy(rng.uniform(0.4, 0.5, (3, 1, *(SMALL.image_size,) * 2))).float()
    depth[1, :, :, :20] = 0.0
    with torch.inference_mode():
        together = network(depth)
        alone = torch.cat([network(one[None]) for one in depth])
    torch.testing.assert_close(together, alone, atol=1e-5, rtol=1e-4)


def crumpled_examples(count):
    """Pictures of a folded, turned towel with the canonical coordinates of their pixels."""
    frame = canonical_frame("towel")
    mesh = garment("towel", vertex_count=400)
    depths, pixels, targets = [], [], []
    for index in range(count):
        angle, crease = 0.7 * index, 0.01 + 0.008 * index
        cosine, sine = np.cos(angle), np.sin(angle)
        flat = mesh.vertices @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
        over = flat[:, 0] > crease
        vertices = flat.copy()
        vertices[over, 0] = 2 * crease - flat[over, 0]
        vertices[:, 2] = np.where(over, 0.006, 0.0015)
        camera = view_camera(vertices, SMALL)
        buffer = Rasterizer(mesh.faces, camera).render(vertices)
        depth = np.where(np.isfinite(buffer.depth), buffer.depth, 0.0).astype(np.float32)
        found = cloth_pixels(depth, SMALL)
        face = buffer.faces[tuple(found.sources.T)]
        depths.append(depth[None])
        pixels.append(np.column_stack([np.full(len(found.pixels), index), found.pixels]))
        targets.append(frame.to_unit(mesh.canonical[mesh.faces[face]].mean(axis=1)))
    return (
        torch.from_numpy(np.stack(depths)),
        torch.from_numpy(np.concatenate(pixels)),
        torch.from_numpy(np.concatenate(targets)).float(),
    )


@pytest.mark.slow
def test_the_small_network_can_learn_eight_pictures_by_heart():
    torch.manual_seed(0)
    depth, pixels, targets = crumpled_examples(8)
    network = Canonicaliser(SMALL)
    optimizer = torch.optim.AdamW(network.parameters(), lr=2e-3)
    signs = torch.from_numpy(symmetries("towel")).float()
    image = pixels[:, 0]

    def error(logits):
        with torch.no_grad():
            found = coordinates(logits)[0]
            each = torch.stack(
                [
                    torch.zeros(8).index_add(
                        0, image, (found - relabeled(targets, one)).norm(dim=1)
                    )
                    for one in signs
                ]
            )
            return float((each / torch.bincount(image)).amin(dim=0).mean())

    errors = []
    for _ in range(40):
        logits = network.logits(network(depth), pixels)
        errors.append(error(logits))
        optimizer.zero_grad()
        canonical_loss(logits, targets, image, signs, 8).backward()
        optimizer.step()
    assert np.mean(errors[-3:]) < 0.6 * errors[0]
