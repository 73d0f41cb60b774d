"""Batches that are rendered of states: names, places, statistics, devices."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from scipy.stats import ks_2samp
from seen_above import waved

from clothtrack.garments.garment_meshes import garment
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.reconstruction.data.state_store import StateShard
from clothtrack.reconstruction.tokens.garment_tokens import GarmentTokens
from clothtrack.reconstruction.tokens.token_examples import token_example
from clothtrack.reconstruction.tokens.token_network import EMPTY, TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_pictures import PIXELS, TokenPictures
from clothtrack.reconstruction.tokens.token_stage import TokenBatch, collate_tokens
from clothtrack.reconstruction.tokens.token_states import TokenStates
from clothtrack_lab.published_networks.rendered_state import render

NETWORK = TokenNetworkConfig()
EXACT = SensorConfig.perfect()
PERFECT = RenderConfig(sensors=(EXACT,) * 3, mask_jitter=0.0, tool=0.0, cut=0.0)
MESHES = [
    garment("towel", vertex_count=300, pattern="random"),
    garment("towel", vertex_count=500, size_m=(1.0, 0.6), pattern="random"),
    garment("tshirt", vertex_count=700),
]
STATES = 16


@pytest.fixture(scope="module")
def tokens():
    return [GarmentTokens.of(mesh) for mesh in MESHES]


@pytest.fixture(scope="module")
def shapes():
    return [
        np.stack([waved(mesh, 100 * number + one) for one in range(STATES)])
        for number, mesh in enumerate(MESHES)
    ]


@pytest.fixture(scope="module")
def states(shapes):
    return TokenStates.joined(
        [
            TokenStates.of(
                StateShard("any", mesh, each, np.arange(STATES), ("drop",) * STATES, number)
            )
            for number, (mesh, each) in enumerate(zip(MESHES, shapes, strict=True))
        ]
    )


def own_place(batch):
    """Where each named pixel is, from its column, row and height."""
    size = NETWORK.output_size
    rows, columns = batch.pixels.unbind(2)
    block = batch.height.view(-1, size, 2, size, 2).amax((2, 4)).flatten(1)
    height = block.gather(1, rows * size + columns)
    tick = np.tan(np.radians(NETWORK.field_of_view_deg / 2.0)) / size
    along = tick * (batch.distance[:, None] - height)
    x, y = (2 * columns + 1 - size) * along, -(2 * rows + 1 - size) * along
    return torch.stack([x, y, height], 2)


def named_place(batch):
    """Where the tokens are that each pixel is called by."""
    index = batch.pixel_tokens.flatten(1)[..., None].expand(-1, -1, 3)
    at = batch.places.gather(1, index).view(*batch.pixel_tokens.shape, 3)
    return (at * batch.pixel_shares[..., None]).sum(2)


def test_names_places_and_pictures_say_the_same(states):
    """However the world is mirrored and turned: the tokens of a pixel lie where it was measured."""
    batch = TokenPictures(states, NETWORK, rendering=PERFECT).batch(torch.arange(48), (0,))
    apart = (named_place(batch) - own_place(batch)).norm(dim=2)
    # The size that is told is a few percent off, and a token is a patch of cloth.
    assert apart.median() < 0.025
    assert apart.flatten().quantile(0.95) < 0.07
    # As many are mirrored as not: a mirrored shirt with the names of a plain one would be far off.
    assert apart.median(1).values.max() < 0.05
    torch.testing.assert_close(batch.pixel_shares.sum(2), torch.ones(48, PIXELS), atol=2e-3, rtol=0)
    assert bool((batch.weight == 1.0).all())
    for one in fields(TokenBatch):
        assert len(getattr(batch, one.name)) == 48


def summary(batch):
    """Per picture: cloth's share, height, its curvature and slope, holes, distance, places."""
    shown = batch.height > 0.5 * EMPTY
    count = shown.sum((1, 2)).float()
    height = torch.where(shown, batch.height, 0.0)
    right = shown[:, :, 1:] & shown[:, :, :-1]
    step = (height[:, :, 1:] - height[:, :, :-1]) * right
    bend = (step[:, :, 1:] - step[:, :, :-1]) * (right[:, :, 1:] & right[:, :, :-1])
    wide = torch.nn.functional.max_pool2d(shown.float()[:, None], 5, 1, 2)
    closed = -torch.nn.functional.max_pool2d(-wide, 5, 1, 2)[:, 0]
    return torch.stack(
        [
            count / shown[0].numel(),
            height.sum((1, 2)) / count,
            bend.abs().sum((1, 2)) / count,
            step.abs().sum((1, 2)) / count,
            ((closed > 0) & ~shown).sum((1, 2)) / (closed > 0).sum((1, 2)),
            batch.distance,
            batch.places[..., 2].mean(1),
            batch.places[..., :2].norm(dim=2).mean(1),
            (named_place(batch) - own_place(batch)).norm(dim=2).mean(1),
            batch.conventional[:, 0],
        ],
        1,
    )  # fmt: skip


@pytest.mark.slow
def test_batches_are_statistically_those_of_single_states(states, shapes, tokens):
    """Cameras, sensors, masks, hands and cuts as they are in training, each state seen twice."""
    config, singles = RenderConfig(), []
    for kind, mesh in enumerate(MESHES):
        for number in range(2 * STATES):
            rng = np.random.default_rng([kind, number])
            positions = shapes[kind][number % STATES].astype(float)
            picture = render(positions, mesh, config, rng)
            singles.append(token_example(picture, mesh.faces, tokens[kind], NETWORK, rng))
    expected = summary(collate_tokens(singles))
    pictures = TokenPictures(states, NETWORK)
    chosen = torch.cat([STATES * kind + torch.arange(2 * STATES) % STATES for kind in range(3)])
    found = summary(pictures.batch(chosen, (0,)))
    assert torch.isfinite(found).all()
    # Pairs of pictures of one state: four standard errors of the mean difference; and the whole
    # distributions, which by chance differ so much in one test of ten thousand.
    gap = found - expected
    assert (gap.mean(0).abs() < 4.0 * gap.std(0) / len(gap) ** 0.5).all()
    for column in range(found.shape[1]):
        assert ks_2samp(found[:, column], expected[:, column]).pvalue > 1e-4


def test_a_state_that_nobody_sees_is_replaced_by_another_one(states):
    blind = SensorConfig.perfect(dropout=1.0)
    dark = replace(PERFECT, noise_range=(1.0, 1.0), sensors=(blind,) * 3)
    batch = TokenPictures(states, NETWORK, rendering=dark).batch(torch.arange(4), (0,))
    assert not bool(batch.weight.any())
    for one in fields(TokenBatch):
        assert torch.isfinite(getattr(batch, one.name).float()).all(), one.name
    half = replace(dark, sensors=(EXACT, blind, blind))
    batch = TokenPictures(states, NETWORK, rendering=half).batch(torch.arange(32), (1,))
    assert bool((batch.weight == 1.0).all())
    shown = (batch.height > 0.5 * EMPTY).flatten(1).any(1)
    assert bool(shown.all())
    assert len(torch.unique(batch.distance)) < 32


@pytest.mark.gpu
def test_a_gpu_sees_what_a_processor_sees(states):
    """With perfect sensors the device only rounds; names of pixels are drawn by each by itself."""
    chosen = torch.arange(48)
    here, there = (
        TokenPictures(states, NETWORK, rendering=PERFECT, device=device).batch(chosen, (0,))
        for device in ("cpu", "cuda")
    )
    found = replace(there, **{one.name: getattr(there, one.name).cpu() for one in fields(there)})
    both = (here.height > 0.5 * EMPTY) & (found.height > 0.5 * EMPTY)
    either = (here.height > 0.5 * EMPTY) | (found.height > 0.5 * EMPTY)
    assert both.sum() > 0.99 * either.sum()
    assert (here.height - found.height)[both].abs().quantile(0.99) < 1e-3
    torch.testing.assert_close(found.places, here.places, atol=1e-3, rtol=0)
    apart = (named_place(found) - own_place(found)).norm(dim=2)
    assert apart.median() < 0.025
