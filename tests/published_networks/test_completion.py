from dataclasses import replace

import numpy as np
import pytest
import torch

from clothtrack_lab.published_networks.completion import (
    RESIDUAL_M,
    Completion,
    ObservedPoints,
    WarpField,
    in_box,
    sample,
    scatter_max,
)
from clothtrack_lab.published_networks.network_config import NetworkConfig

TINY = NetworkConfig(volume=8, volume_channels=8, volume_widths=(8, 16), decoder_hidden=16, grid=9)


def cell_centers(cells):
    along = (torch.arange(cells) + 0.5) / cells
    return torch.stack(torch.meshgrid(along, along, along, indexing="ij"), dim=-1)


def points_for(rng, images, each=40, channels=5):
    count = images * each
    draw = lambda width: torch.from_numpy(rng.random((count, width))).float()  # noqa: E731
    image = torch.arange(count) // each
    return ObservedPoints(draw(channels), draw(3), draw(3), draw(3), image, images)


def only(points, image):
    chosen = points.image == image
    parts = (points.features, points.unit, points.confidence, points.aligned)
    return ObservedPoints(
        *(part[chosen] for part in parts), torch.zeros(int(chosen.sum())).long(), 1
    )


@pytest.mark.parametrize("place", [(1, 2, 5), (6, 3, 1), (0, 7, 4)])
def test_a_cell_filled_at_xyz_is_read_at_xyz_and_nowhere_else(place):
    # The published sampler returns this cell at (z, y, x).
    cells = 8
    unit = (torch.tensor([place]) + 0.5) / cells
    volume = scatter_max(torch.ones(1, 1), unit, torch.zeros(1).long(), 1, (cells,) * 3)
    read = sample(volume, cell_centers(cells).reshape(1, -1, 3)).reshape(cells, cells, cells)
    expected = torch.zeros(cells, cells, cells)
    expected[place] = 1.0
    torch.testing.assert_close(read, expected, atol=1e-5, rtol=0)


def test_a_linear_field_is_read_exactly_between_cell_centers(rng):
    slopes = torch.tensor([1.0, -2.0, 0.5])
    volume = (cell_centers(8) @ slopes)[None, None]
    queries = torch.from_numpy(rng.uniform(1 / 16, 15 / 16, (1, 100, 3))).float()
    torch.testing.assert_close(sample(volume, queries)[..., 0], queries @ slopes)


def test_scatter_takes_the_largest_of_a_cell_and_keeps_pictures_apart():
    unit = torch.tensor([[0.1, 0.1, 0.1], [0.12, 0.1, 0.1], [0.1, 0.1, 0.1], [0.9, 0.1, 1.0]])
    values = torch.tensor([[1.0, 5.0], [3.0, 2.0], [9.0, 0.0], [4.0, 4.0]])
    volume = scatter_max(values, unit, torch.tensor([0, 0, 1, 1]), 2, (4, 4, 4))
    assert volume.shape == (2, 2, 4, 4, 4)
    assert volume[0, :, 0, 0, 0].tolist() == [3.0, 5.0]
    assert volume[1, :, 0, 0, 0].tolist() == [9.0, 0.0]
    assert volume[1, :, 3, 0, 3].tolist() == [4.0, 4.0]
    assert volume.sum() == 3 + 5 + 9 + 8


def test_a_batch_gives_what_its_pictures_give_alone(rng):
    network = Completion(TINY, 5).eval()
    warp = WarpField(TINY).eval()
    torch.nn.init.normal_(warp.decoder[-1].weight)
    points = points_for(rng, 3)
    queries = torch.from_numpy(rng.random((3, 20, 3))).float()
    with torch.inference_mode():
        volume = network(points)
        together = network.winding(volume, queries), warp(volume, queries)
        for image in range(3):
            one = network(only(points, image))
            near = {"atol": 1e-5, "rtol": 1e-4}
            torch.testing.assert_close(volume[image : image + 1], one, **near)
            query = queries[image : image + 1]
            torch.testing.assert_close(
                together[0][image : image + 1], network.winding(one, query), **near
            )
            torch.testing.assert_close(together[1][image : image + 1], warp(one, query), **near)


def test_an_untrained_warp_lies_in_the_canonical_pose_and_can_leave_it(rng):
    warp = WarpField(TINY)
    volume = torch.from_numpy(rng.normal(size=(1, 8, 8, 8, 8))).float()
    queries = torch.from_numpy(rng.random((1, 30, 3))).float()
    assert (warp(volume, queries) == 0).all()
    warp(volume, queries).sum().backward()
    assert warp.decoder[-1].weight.grad.abs().max() > 0
    np.testing.assert_allclose(warp.decoder[-1].bias.grad, 30 * RESIDUAL_M, rtol=1e-5)


def test_places_stay_exact_in_half_precision():
    """A ramp is read where the query is, not at the nearest of the 256 places of bfloat16."""
    ramp = (torch.arange(32) + 0.5).expand(1, 1, 32, 32, 32).to(torch.bfloat16)
    places = torch.linspace(0.1, 0.9, 401)
    queries = torch.stack([places, places, places], dim=1)[None]
    np.testing.assert_allclose(sample(ramp, queries)[0, :, 0], 32 * places, atol=1e-3)


def test_a_flat_volume_reads_what_a_whole_one_does():
    """The same field in a cube and in its middle quarter: the same answers inside."""
    whole = torch.rand(1, 3, 16, 16, 16)
    config = replace(TINY, volume=16, volume_depth=4)
    rng = np.random.default_rng(0)
    # Between the centers of its outermost cells: beyond them a flat volume goes on as it ends.
    queries = torch.from_numpy(rng.uniform(0.41, 0.59, (1, 50, 3))).float()
    read = sample(whole[..., 6:10], in_box(queries, config))
    torch.testing.assert_close(read, sample(whole, queries))
