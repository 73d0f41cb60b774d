"""Several hypotheses of the places, and weights that grow into a larger network."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.garments.garment_meshes import garment
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.data.render_config import RenderConfig
from clothtrack.reconstruction.tokens.garment_tokens import GarmentTokens
from clothtrack.reconstruction.tokens.token_examples import token_example
from clothtrack.reconstruction.tokens.token_learning import (
    KIND,
    PREFIX,
    grown,
    require_tokens,
    split_by_digest,
)
from clothtrack.reconstruction.tokens.token_network import TokenNetwork, TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_stage import TokenExample, TokenStage, collate_tokens
from clothtrack.reconstruction.training.checkpoint import Weights
from clothtrack_lab.published_networks.rendered_state import render

SMALL = TokenNetworkConfig(width=16, layers=1, hypotheses=1)


@pytest.fixture(scope="module")
def drawn() -> TokenExample:
    mesh: ClothMesh = garment("towel", vertex_count=300, size_m=(0.4, 0.25))
    positions = np.asarray(mesh.vertices, float) + [0.0, 0.0, 0.01]
    rng = np.random.default_rng(2)
    picture = render(positions, mesh, RenderConfig(), rng)
    return token_example(picture, mesh.faces, GarmentTokens.of(mesh), SMALL, rng)


def weights_of(network: TokenNetwork) -> Weights:
    tensors = {PREFIX + name: value for name, value in network.state_dict().items()}
    return Weights(Path("small.safetensors"), tensors, asdict(network.config), KIND)


def test_grown_weights_answer_as_before(drawn: TokenExample) -> None:
    torch.manual_seed(0)
    small = TokenNetwork(SMALL).eval()
    wanted = replace(SMALL, layers=3, hypotheses=4)
    large = TokenNetwork(wanted).eval()
    grown(weights_of(small), wanted).load_into(large, prefix=PREFIX)
    asked = collate_tokens([drawn]).asked
    with torch.no_grad():
        before, after = small(asked), large(asked)
    torch.testing.assert_close(after.names, before.names)
    torch.testing.assert_close(after.places[:, :1], before.places)
    assert not torch.allclose(after.places[:, 1], before.places[:, 0], atol=1e-4)
    torch.testing.assert_close(after.choice, torch.zeros(1, 4))


def test_weights_of_other_sizes_do_not_grow() -> None:
    small = weights_of(TokenNetwork(SMALL))
    with pytest.raises(InvalidResultError, match=r"network\.width is 32, there 16"):
        grown(small, replace(SMALL, width=32))
    with pytest.raises(InvalidResultError, match="may have fewer layers"):
        grown(weights_of(TokenNetwork(replace(SMALL, layers=2))), SMALL)
    # Weights from before there were hypotheses have one.
    old = {name: value for name, value in small.network.items() if name != "hypotheses"}
    assert require_tokens(replace(small, network=old)) == SMALL


@pytest.mark.slow
def test_two_foldings_of_one_picture_become_two_hypotheses(drawn: TokenExample) -> None:
    torch.manual_seed(1)
    network = TokenNetwork(replace(SMALL, hypotheses=2))
    network.examples.fill_(100_000)
    stage = TokenStage(network)
    # The same picture shows the cloth with one half 0.3 sides higher, or with the other.
    half = drawn.features[:, 0] > 0.0
    lifted = [drawn.places + 0.3 * np.outer(up, [0.0, 0.0, 1.0]) for up in (half, ~half)]
    only = {"labelings": drawn.labelings[:1], "is_labeling": drawn.is_labeling[:1]}
    only["conventional"] = drawn.conventional[:1]
    both = collate_tokens([replace(drawn, places=p.astype(np.float32), **only) for p in lifted])
    optimizer = torch.optim.Adam(network.parameters(), 1e-2)
    for _ in range(60):
        optimizer.zero_grad()
        stage(both)["loss"].backward()
        optimizer.step()
    with torch.no_grad():
        likelihoods = network(both.asked).choice.softmax(-1)
        # One answer would lie between the two, 0.15 from each.
        assert float(stage.measure(both)["nearest_error"].mean()) < 0.08
    torch.testing.assert_close(likelihoods, torch.full((2, 2), 0.5), atol=0.15, rtol=0.0)


def test_a_garment_stays_held_out_whatever_else_is_learned_from() -> None:
    rng = np.random.default_rng(0)
    digests = [rng.bytes(32).hex() for _ in range(300)]
    _, held_few = split_by_digest(digests[:100], 0.2)
    training, held_many = split_by_digest(digests, 0.2)
    assert {digests[k] for k in held_few} <= {digests[k] for k in held_many}
    assert 40 < len(held_many) < 80
    assert sorted([*training, *held_many]) == list(range(300))
    # States of one garment stay together.
    training, held = split_by_digest(["0a" * 32, "ff" * 32, "0a" * 32, "ff" * 32], 0.1)
    assert (training.tolist(), held.tolist()) == ([1, 3], [0, 2])
    with pytest.raises(InvalidConfigError, match="2 states of 1 garments, of which 1 are held"):
        split_by_digest(["ff" * 32] * 2, 0.1)
